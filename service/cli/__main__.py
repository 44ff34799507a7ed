"""``python -m wrenchbook`` of a wheel; in a checkout `wrenchbook.py` is that program."""

from wrenchbook import main

main()
