"""Where solvers run: what an engine is, and the engines there are."""
