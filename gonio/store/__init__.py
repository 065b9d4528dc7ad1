"""The measured file: written position by position, read back as a `Scan`."""

from __future__ import annotations

from gonio.store.scan import Scan

__all__ = ["Scan"]
