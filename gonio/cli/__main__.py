"""`python -m gonio.cli` is `gonio`."""

import sys

from gonio.cli.main import main

sys.exit(main())
