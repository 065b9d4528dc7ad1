"""Fixtures of the sphere's tests; `perkinelmer_files.py` beside this file writes instruments' files."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # tests are no package; the helper module is found beside them
