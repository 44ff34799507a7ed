"""The ways to answer, in one registry, and which is the default."""
