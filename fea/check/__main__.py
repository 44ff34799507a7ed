"""``python -m wrenchbook.fea.check``: see `fea.check.reporting.main`."""

import sys

from wrenchbook.fea.check.reporting import main

sys.exit(main(sys.argv[1:]))
