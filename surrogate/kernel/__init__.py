"""The compiled code that answers from a packed table, and its Python binding."""
