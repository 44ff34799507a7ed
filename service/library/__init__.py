"""The components a server knows: shipped ones and uploaded bundles."""
