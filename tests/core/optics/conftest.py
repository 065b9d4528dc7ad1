"""`mp_lobe.py` beside this file has the lobe integral in 30 digits."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # tests are no package; the helper module is found beside them
