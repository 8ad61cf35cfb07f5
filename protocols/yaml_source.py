"""YAML text -> plain values with the line and column of every key, within fixed bounds of time and memory.

Read from ruamel.yaml's event stream (YAML 1.2), one event at a time, so that what is too big, too deep, cyclic or
tagged is refused where it stands, before anything is built from it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from stimuli.errors import InputError, problem

MAX_BYTES = 128 * 1024
MAX_EVENTS = 12_000
MAX_DEPTH = 24
MAX_VALUES = 40_000  # after aliases have been followed

_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_TRUE, _FALSE = frozenset({"true", "True", "TRUE"}), frozenset({"false", "False", "FALSE"})
_INT = re.compile(r"[-+]?[0-9]{1,18}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]{1,40}|[0-9]{1,40}(\.[0-9]{0,40})?)([eE][-+]?[0-9]{1,4})?")
_WIDE = re.compile(r"[-+]?([0-9]{19,}|0[xo][0-9a-fA-F]+|\.inf|\.Inf|\.INF|\.nan|\.NaN|\.NAN)")


@dataclass(frozen=True)
class Mark:
    """A place in a file; line and column count from 1."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


@dataclass(eq=False)
class Node:
    """A value with its place. ``entries``: key -> (place of the key, value); ``items``: a sequence's values."""

    mark: Mark
    scalar: Any = None
    entries: dict[str, tuple[Mark, Node]] | None = None
    items: list[Node] | None = None
    size: int = 1

    def plain(self) -> Any:
        """Dictionaries, lists and scalars; aliases are followed (bounded by MAX_VALUES when read)."""
        if self.entries is not None:
            return {key: node.plain() for key, (_, node) in self.entries.items()}
        if self.items is not None:
            return [node.plain() for node in self.items]
        return self.scalar

    def find(self, path: Sequence[str | int]) -> Mark:
        """The place of the deepest key on ``path`` that exists; steps that lead nowhere are passed over."""
        node, mark = self, self.mark
        for step in path:
            if node.entries is not None and step in node.entries:
                mark, node = node.entries[str(step)]
            elif node.items is not None and isinstance(step, int) and step < len(node.items):
                node = node.items[step]
                mark = node.mark
        return mark


@dataclass
class _Open:
    """A collection that is being read."""

    node: Node
    anchor: str | None
    key: tuple[str, Mark] | None = None
    merges: list[Node] = field(default_factory=list)


def read_yaml(path: Path, name: str | None = None) -> Node:
    """The root node of a YAML file. Raises InputError with one line for each problem found."""
    shown = name or path.name
    try:
        raw = path.read_bytes() if path.stat().st_size <= MAX_BYTES else None
    except FileNotFoundError:
        raise InputError(problem(shown, "file", "nothing there", "an existing protocol file")) from None
    except OSError as error:
        raise InputError(problem(shown, "file", (error.strerror or "an error").lower(), "a readable file")) from None
    if raw is None:
        raise InputError(problem(shown, "size", f"{path.stat().st_size} bytes", f"at most {MAX_BYTES} bytes"))
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise InputError(problem(f"{shown}:{line}:{column}", "encoding", "not UTF-8", "UTF-8 text")) from None
    return parse_yaml(text, shown)


def parse_yaml(text: str, name: str) -> Node:
    """`read_yaml` for text; ``name`` stands for the file in messages."""
    for number, line in enumerate(text.splitlines(), 1):
        indent = line[: len(line) - len(line.lstrip(" \t"))]
        if "\t" in indent and line.strip() and not line.lstrip().startswith("#"):
            place = f"{name}:{number}:{indent.index(chr(9)) + 1}"
            raise InputError(problem(place, "indentation", "a tab", "spaces"))
    reader = _Reader(name)
    try:
        root = reader.read(YAML(typ="safe", pure=True).parse(text))
    except MarkedYAMLError as error:
        where = error.problem_mark or error.context_mark
        place = f"{name}:{where.line + 1}:{where.column + 1}" if where else name
        raise InputError(problem(place, "yaml", (error.problem or "a syntax error").lower(), "valid YAML")) from None
    except InputError:
        raise
    except (YAMLError, ValueError) as error:
        said = " ".join(str(error).split()) or "a syntax error"
        raise InputError(problem(name, "yaml", said[:160].lower(), "valid YAML")) from None
    if reader.problems:
        raise InputError(*reader.problems)
    if root is None or root.entries is None:
        start = root.mark if root else Mark(name, 1, 1)
        raise InputError(problem(start, "document", "no mapping", "keys and values, starting with study: NAME"))
    return root


class _Reader:
    """Builds nodes from events; collects the problems that do not stop the reading."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.problems: list[str] = []
        self.anchors: dict[str, Node] = {}
        self.stack: list[_Open] = []
        self.root: Node | None = None

    def read(self, events: Iterator[Any]) -> Node | None:
        documents = 0
        for count, event in enumerate(events):
            kind = type(event).__name__
            mark = Mark(self.name, event.start_mark.line + 1, event.start_mark.column + 1)
            if count >= MAX_EVENTS:
                raise InputError(problem(mark, "size", f"more than {MAX_EVENTS} parts", "a shorter protocol"))
            if kind == "DocumentStartEvent":
                documents += 1
                if documents > 1:
                    raise InputError(problem(mark, "document", "a second document", "one document a file"))
            elif kind in ("MappingStartEvent", "SequenceStartEvent"):
                self._open(event, kind == "MappingStartEvent", mark)
            elif kind in ("MappingEndEvent", "SequenceEndEvent"):
                self._close()
            elif kind == "ScalarEvent":
                self._refuse_tag(event, mark)
                node = Node(mark, self._scalar(event, mark))
                if event.anchor:
                    self.anchors[event.anchor] = node
                self._add(node)
            elif kind == "AliasEvent":
                self._add(self._alias(event, mark))
        return self.root

    def _open(self, event: Any, is_mapping: bool, mark: Mark) -> None:
        self._refuse_tag(event, mark)
        if len(self.stack) >= MAX_DEPTH:
            raise InputError(problem(mark, "depth", f"more than {MAX_DEPTH} levels", "a flatter protocol"))
        node = Node(mark, entries={}) if is_mapping else Node(mark, items=[])
        self.stack.append(_Open(node, event.anchor))

    def _close(self) -> None:
        done = self.stack.pop()
        node = done.node
        if node.entries is not None:
            # A merge key brings in what the mapping does not say itself.
            for merged in done.merges:
                for key, entry in (merged.entries or {}).items():
                    node.entries.setdefault(key, entry)
            node.size = 1 + sum(value.size for _, value in node.entries.values())
        else:
            node.size = 1 + sum(value.size for value in node.items or ())
        if node.size > MAX_VALUES:
            raise InputError(problem(node.mark, "size", f"{node.size} values after aliases", f"at most {MAX_VALUES}"))
        if done.anchor:
            self.anchors[done.anchor] = node
        self._add(node)

    def _alias(self, event: Any, mark: Mark) -> Node:
        if any(outer.anchor == event.anchor for outer in self.stack):
            self.problems.append(problem(mark, "alias", f"*{event.anchor} inside itself", "no cycle"))
            return Node(mark)
        if event.anchor not in self.anchors:
            self.problems.append(problem(mark, "alias", f"*{event.anchor}", "an anchor written before it"))
            return Node(mark)
        return self.anchors[event.anchor]

    def _add(self, node: Node) -> None:
        if not self.stack:
            self.root = node
            return
        top = self.stack[-1]
        if top.node.items is not None:
            top.node.items.append(node)
        elif top.key is None:
            top.key = self._key(node)
        else:
            (key, mark), top.key = top.key, None
            self._put(top, key, mark, node)

    def _put(self, top: _Open, key: str, mark: Mark, node: Node) -> None:
        entries = top.node.entries
        if entries is None:
            return
        if key == "<<":
            merged = node.items if node.items is not None else [node]
            if any(part.entries is None for part in merged):
                self.problems.append(problem(mark, "merge key", "no mapping", "<<: *anchor of a mapping"))
            top.merges += merged
        elif key in entries:
            first = entries[key][0]
            self.problems.append(
                problem(mark, f"key {key!r}", "it a second time", f"once (first in line {first.line})")
            )
        else:
            entries[key] = (mark, node)

    def _key(self, node: Node) -> tuple[str, Mark]:
        if node.entries is not None or node.items is not None:
            self.problems.append(problem(node.mark, "key", "a collection", "a word"))
            return f"\0{node.mark}", node.mark
        value = node.scalar
        return ("" if value is None else str(value).lower() if isinstance(value, bool) else str(value)), node.mark

    def _refuse_tag(self, event: Any, mark: Mark) -> None:
        tag = getattr(event, "tag", None)
        if tag is not None and not (str(tag) == "!" or str(tag).startswith("tag:yaml.org,2002:str")):
            self.problems.append(problem(mark, "tag", str(tag)[:60], "no tags"))

    def _scalar(self, event: Any, mark: Mark) -> Any:
        """The value of a plain or quoted scalar by the YAML 1.2 core schema; quoted scalars are text."""
        text = event.value
        if not event.implicit[0]:
            return text
        if text in _NULL:
            return None
        if text in _TRUE or text in _FALSE:
            return text in _TRUE
        if _INT.fullmatch(text):
            return int(text)
        wide = _WIDE.fullmatch(text) is not None
        if not wide and _FLOAT.fullmatch(text):
            value = float(text)
            if math.isfinite(value):
                return value
            wide = True
        if wide:
            self.problems.append(problem(mark, "number", text[:40], "a finite decimal number of at most 18 digits"))
            return None
        return text
