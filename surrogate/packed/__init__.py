"""The packed table: one version of a table as one immutable file from which the kernel answers."""
