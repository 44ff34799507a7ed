"""``python -m wrenchbook.fea.check FOLDER``: the command ``wrenchbook check``."""

import sys

from wrenchbook.fea.check.commands import main

sys.exit(main(["check", *sys.argv[1:]]))
