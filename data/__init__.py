"""The shipped library of components, tables and scenes."""
