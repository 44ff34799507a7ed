"""Error against run time: a table's methods and sizes, and finite elements at three meshes."""
