"""``python -m fea.check``: see `fea.check.report.main`."""

import sys

from fea.check.report import main

sys.exit(main(sys.argv[1:]))
