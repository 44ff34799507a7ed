"""Which wrench to solve next."""
