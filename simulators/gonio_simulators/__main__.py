"""`python -m gonio_simulators`: the simulated bench."""

import sys

from gonio_simulators.cli import main

sys.exit(main())
