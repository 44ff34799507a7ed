"""Live surrogates that follow the ledger."""
