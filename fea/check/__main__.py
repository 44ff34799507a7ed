"""``python -m fea.check``: see `fea.check.reporting.main`."""

import sys

from fea.check.reporting import main

sys.exit(main(sys.argv[1:]))
