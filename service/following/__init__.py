"""A server elsewhere that answers from copies of another's tables, and hands on all else."""
