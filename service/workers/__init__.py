"""Several processes that are one server: one builds and solves, the others answer."""
