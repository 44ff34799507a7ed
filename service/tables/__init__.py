"""Tables that follow the ledger, their builder and their files."""
