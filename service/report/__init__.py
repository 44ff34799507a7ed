"""Error against run time: a table's methods and sizes beside finite elements at three meshes."""
