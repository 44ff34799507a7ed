"""The components of a server: shipped ones and uploaded bundles."""
