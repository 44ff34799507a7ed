"""A component and a wrench in, a displacement out: finite elements."""
