"""The packed table: one version of a table as one immutable file that answers come from."""
