"""The key-value storage of a Zaber device: what ``storage`` commands store and print.

    storage [axis|all] set KEY VALUE...     append KEY VALUE...     get KEY     erase KEY     exists KEY
    storage [axis|all] print [keys] [prefix PREFIX]

Keys of the device and of its axis are apart; ``all`` prints both.
"""

from __future__ import annotations

from collections.abc import Sequence

from gonio_simulators.wire.zaber_message import Rejected


class Storage:
    """What one device stores; it survives power."""

    def __init__(self) -> None:
        self._texts: tuple[dict[str, str], dict[str, str]] = ({}, {})  # of the device, of its axis

    def carry_out(self, words: Sequence[str], axis: int) -> tuple[str, list[str]]:
        """Return the data of the reply and the info lines behind it, each with its scope in front."""
        scopes = [0]
        if words[:1] in (("axis",), ("all",)):
            scopes = [1] if words[0] == "axis" else [0, 1]
            if words[0] == "axis" and axis != 1:
                raise Rejected("BADAXIS")
            words = words[1:]
        if words[:1] == ("print",):
            return "0", self._print(words[1:], scopes)
        if len(words) < 2 or len(scopes) != 1:
            raise Rejected("BADCOMMAND")
        texts = self._texts[scopes[0]]
        verb, key, value = words[0], words[1], " ".join(words[2:])
        if verb in ("set", "append") and value:
            if verb == "append" and key in texts:
                value = f"{texts[key]} {value}"
            texts[key] = value
            return "0", []
        if value or verb not in ("get", "erase", "exists"):
            raise Rejected("BADCOMMAND")
        if verb == "exists":
            return str(int(key in texts)), []
        if key not in texts:
            raise Rejected("BADDATA")
        return (texts[key], []) if verb == "get" else (self._erase(texts, key), [])

    def _print(self, words: Sequence[str], scopes: Sequence[int]) -> list[str]:
        keys_only = words[:1] == ("keys",)
        words = words[keys_only:]
        if words and (words[0] != "prefix" or len(words) != 2):
            raise Rejected("BADCOMMAND")
        prefix = words[1] if words else ""
        lines = []
        for scope in scopes:
            for key, text in sorted(self._texts[scope].items()):
                if key.startswith(prefix):
                    head = f"axis {scope} set" if scope else "set"
                    lines.append(f"{head} {key}" if keys_only else f"{head} {key} {text}")
        return lines

    @staticmethod
    def _erase(texts: dict[str, str], key: str) -> str:
        del texts[key]
        return "0"
