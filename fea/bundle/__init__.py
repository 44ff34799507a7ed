"""From a folder with ``component.toml`` to a checked bundle; builds no mesh."""
