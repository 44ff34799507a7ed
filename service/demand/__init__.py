"""What was asked of the tables and not covered."""
