"""Reading a folder with ``component.toml`` into a checked bundle, without building a mesh."""
