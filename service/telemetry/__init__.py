"""What an operator sees of a server: its counts for Prometheus, its log."""
