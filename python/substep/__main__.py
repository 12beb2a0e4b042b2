"""`python -m substep` is `substep`."""

import sys

from .cli import main

sys.exit(main())
