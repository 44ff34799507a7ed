"""HTTP, ledger, engines and command line."""
