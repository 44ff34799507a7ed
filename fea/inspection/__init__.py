"""What a look at a component tells before anything is solved: its cells, bodies and places."""
