"""The contents of a bundle, read key by key and checked, without its mesh."""
