"""Statistics of queries that the tables did not cover."""
