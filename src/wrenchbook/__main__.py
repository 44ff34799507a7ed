"""The command line: ``python -m wrenchbook``."""

from wrenchbook import main

main()
