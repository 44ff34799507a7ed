"""From an accepted job to a row: dispatcher, leases, attempts, engines."""
