"""Fields of a solution: displacement of the surface, stresses at the integration points."""
