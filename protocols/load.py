"""YAML file -> Study. Every problem at once, each as ``file:line:column: what: got X, wanted Y``."""

from __future__ import annotations

import difflib
import json
import types
import typing
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from protocols.gaze_demands import gaze_problems
from protocols.match_lock import SUFFIX, read_lock, with_lock
from protocols.names import Problem
from protocols.references import reference_problems
from protocols.session_size import size_problems
from protocols.study import Study
from protocols.yaml_source import Mark, Node, read_yaml
from stimuli.errors import InputError, problem

LIBRARY = Path(__file__).parent / "library"
MAX_EXTENDS = 4
Step = str | int
_PLAIN = {
    "missing": "a value here", "int_type": "a whole number", "int_from_float": "a whole number",
    "int_parsing": "a whole number", "float_type": "a number", "string_type": "text", "bool_type": "true or false",
    "list_type": "a list [...]", "tuple_type": "a list [...]", "dict_type": "keys and values",
    "model_type": "keys and values", "model_attributes_type": "keys and values", "finite_number": "a finite number",
}  # fmt: skip


def load_study(path: str | Path) -> Study:
    """The study that the file at ``path`` describes (a bare name such as 'demo' is looked up in the library).

    Raises InputError whose ``problems`` are all that is wrong, sorted by place.
    """
    return read_study(path)[0]


def read_study(path: str | Path) -> tuple[Study, str]:
    """`load_study`, and the text of the file (of all files that it extends, first the widest).

    Where `studyapp match` has written its lock, conditions have the solved parameters, and the text ends with the lock
    as comments.
    """
    study, text = read_unmatched(path)
    lock = match_file(path)
    if not study.match or not lock.is_file():
        return study, text
    said = "".join(f"# {line}\n" for line in lock.read_text(encoding="utf-8").splitlines())
    return with_lock(study, read_lock(lock), lock), f"{text.rstrip()}\n# --- {lock.name}\n{said}"


def match_file(path: str | Path) -> Path:
    """NAME.match.yaml beside the protocol (for shipped protocols, in the current folder)."""
    file = library_path(path)
    folder = Path.cwd() if file.parent == LIBRARY else file.parent
    return folder / f"{file.stem}{SUFFIX}"


def read_unmatched(path: str | Path) -> tuple[Study, str]:
    """`read_study` as if nothing had been matched."""
    file = library_path(path)
    root, text = _extended(file, 0, [])
    written = root.plain()
    (root.entries or {}).pop("extends", None)
    problems: dict[tuple[str, int, int, str], str] = {}
    study = _validated(root, problems)
    if study is not None:
        for loc, what, got, wanted in reference_problems(study, written):
            _note(problems, root.find(loc), what, got, wanted)
        # What forms cells comes after what bounds their number, and only where every name leads somewhere.
        for check in (size_problems, gaze_problems):
            for loc, what, got, wanted in check(study) if not problems else ():
                _note(problems, root.find(loc), what, got, wanted)
    if problems:
        raise InputError(*[problems[key] for key in sorted(problems)])
    assert study is not None
    return study, text


def read_root(path: str | Path) -> Node:
    """The file's root node as written, with what it extends; for whoever finds mistakes that loading does not look for.
    InputError where it is no YAML."""
    return _extended(library_path(path), 0, [])[0]


def located(root: Node, found: Iterable[Problem]) -> list[str]:
    """Problems as lines, each at its place in the file."""
    return [problem(root.find(loc), what, got, wanted) for loc, what, got, wanted in found]


def library_path(path: str | Path) -> Path:
    """``path``, or the shipped protocol of that name where it has no suffix and no such file exists."""
    file = Path(path)
    shipped = LIBRARY / f"{file.name}.yaml"
    return shipped if not file.suffix and not _is_file(file) and _is_file(shipped) else file


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that the file system does not take
        return False


def _with_path_files(root: Node, file: Path) -> str:
    """Put the keys of files named under ``paths`` in their places; their texts as comments."""
    _, paths = (root.entries or {}).get("paths", (root.mark, root))
    said = ""
    for name, (mark, node) in list((paths.entries or {}).items()) if paths is not root else []:
        if not isinstance(node.scalar, str):
            continue
        keys = file.parent / node.scalar
        if not _is_file(keys):
            wanted = "keys, or a file of keys (studyapp scene --record-path)"
            raise InputError(problem(node.mark, f"paths.{name}", f"{node.scalar!r}, which is not there", wanted))
        assert paths.entries is not None
        paths.entries[name] = (mark, read_yaml(keys, str(keys)))
        said += f"\n# --- {node.scalar}\n" + "".join(
            f"# {line}\n" for line in keys.read_text(encoding="utf-8-sig").splitlines()
        )
    return said


def _extended(file: Path, depth: int, seen: list[Path]) -> tuple[Node, str]:
    """The file's root node, laid over the root of what it ``extends``; and the texts."""
    root = read_yaml(file, str(file))
    text = file.read_text(encoding="utf-8-sig") + _with_path_files(root, file)
    entry = (root.entries or {}).get("extends")
    if entry is None:
        return root, text
    key, node = entry
    if not isinstance(node.scalar, str):
        raise InputError(problem(node.mark, "extends", "no file name", "a protocol file beside this one"))
    wide = file.parent / node.scalar
    if not _is_file(wide) and "/" not in node.scalar:
        wide = LIBRARY / node.scalar
    if depth >= MAX_EXTENDS or wide.resolve() in [*seen, file.resolve()]:
        raise InputError(problem(key, "extends", node.scalar, f"at most {MAX_EXTENDS} files, none of them twice"))
    if not _is_file(wide):
        raise InputError(
            problem(node.mark, "extends", f"{node.scalar!r}, which is not there", "an existing protocol file")
        )
    base, base_text = _extended(wide, depth + 1, [*seen, file.resolve()])
    return _overlay(base, root), base_text + "\n--- # extended by " + file.name + "\n" + text


def _overlay(base: Node, over: Node) -> Node:
    """Mappings are laid over each other key by key, lists of named things (blocks, tests) name by name; all else is
    replaced; null removes."""
    if base.entries is not None and over.entries is not None:
        merged = dict(base.entries)
        for key, (mark, node) in over.entries.items():
            if node.entries is None and node.items is None and node.scalar is None:
                merged.pop(key, None)
            elif key in merged:
                merged[key] = (mark, _overlay(merged[key][1], node))
            else:
                merged[key] = (mark, node)
        return Node(over.mark, entries=merged)
    if base.items and over.items and all(_name_of(node) is not None for node in [*base.items, *over.items]):
        named = {_name_of(node): node for node in base.items}
        for node in over.items:
            name = _name_of(node)
            named[name] = _overlay(named[name], node) if name in named else node
        return Node(over.mark, items=list(named.values()))
    return over


def _name_of(node: Node) -> object:
    return node.entries["name"][1].scalar if node.entries is not None and "name" in node.entries else None


def _validated(root: Node, problems: dict[tuple[str, int, int, str], str]) -> Study | None:
    """Validate; on errors note them, take the faulty parts out of the tree and go on, so that names are checked too."""
    taken: set[tuple[int, Step]] = set()
    for _ in range(8):
        try:
            return Study.model_validate_json(json.dumps(root.plain()))
        except ValidationError as error:
            details = error.errors(include_url=False)
        faulty = [_innermost(root, detail["loc"]) for detail in details]
        for detail, found in zip(details, faulty, strict=True):
            # What was taken out before is not missing: its own fault has been told.
            inside = id(found[2] if found else root)
            if detail["type"] != "missing" or (inside, detail["loc"][-1]) not in taken:
                _note(problems, *_describe(root, detail))
        if None in faulty:
            return None
        for holder, step, part in filter(None, faulty):
            taken.add((id(holder), step))
            _take_out(holder, step, part)
    return None


def _note(problems: dict[tuple[str, int, int, str], str], mark: Mark, what: str, got: str, wanted: str) -> None:
    line = problem(mark, what, got, wanted)
    problems.setdefault((mark.file, mark.line, mark.column, line), line)


def _innermost(root: Node, loc: Sequence[Step]) -> tuple[Node, Step, Node] | None:
    """(holder, step, part) of the innermost part of the file that ``loc`` leads to."""
    node = root
    found: tuple[Node, Step, Node] | None = None
    for step in loc:
        if node.entries is not None and step in node.entries:
            found = (node, step, node.entries[str(step)][1])
        elif node.items is not None and isinstance(step, int) and step < len(node.items):
            found = (node, step, node.items[step])
        node = found[2] if found else node
    return found


def _take_out(holder: Node, step: Step, part: Node) -> None:
    if holder.entries is not None:
        holder.entries.pop(str(step), None)
    elif holder.items is not None:
        holder.items[:] = [item for item in holder.items if item is not part]


def _describe(root: Node, detail: ErrorDetails) -> tuple[Mark, str, str, str]:
    """(place, what, got, wanted) of one error of pydantic's."""
    loc, kind, context = detail["loc"], detail["type"], detail.get("ctx", {})
    steps = _steps(root, loc)
    what = _dotted(steps) or "study"
    value = detail.get("input")
    if kind == "extra_forbidden":
        names = _fields_at(loc[:-1])
        return root.find(loc), what, f"unknown key {str(loc[-1])!r}", suggestion(str(loc[-1]), names)
    if kind == "missing":
        return root.find(loc[:-1]), f"{what}.{loc[-1]}".removeprefix("study."), "nothing", _PLAIN["missing"]
    if kind == "protocol":
        return root.find(loc), what, str(context["got"]), str(context["wanted"])
    if kind == "literal_error":
        choices = [c.strip("' ") for c in str(context["expected"]).replace(" or ", ", ").split(",")]
        return root.find(loc), what, _show(value), suggestion(str(value), choices)
    wanted = _PLAIN.get(kind) or detail["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    wanted = wanted[0].lower() + wanted[1:]
    if kind == "string_pattern_mismatch":
        wanted = f"a name like {'my_study' if what == 'study' else 'my_name'} (letters, digits, _)"
    return root.find(loc), what, _show(value), wanted


def suggestion(word: str, choices: Sequence[str]) -> str:
    """``did you mean 'x'? (a | b | x)``, or the choices alone where none is near."""
    shown = " | ".join(list(choices)[:30]) + (" | ..." if len(choices) > 30 else "")
    near = difflib.get_close_matches(word[:64], choices, n=1, cutoff=0.6)
    return (
        f"{near[0]!r} (did you mean that?), one of {shown}" if near else f"one of {shown}" if shown else "no key here"
    )


def _show(value: Any) -> str:
    text = repr(value) if not isinstance(value, (dict, list)) else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _steps(root: Node, loc: Sequence[Step]) -> list[Step]:
    """The steps of ``loc`` that are keys of the file (pydantic adds names of union members)."""
    node: Node | None = root
    steps: list[Step] = []
    for step in loc:
        if node is not None and node.entries is not None and step in node.entries:
            node = node.entries[str(step)][1]
            steps.append(step)
        elif node is not None and node.items is not None and isinstance(step, int) and step < len(node.items):
            node = node.items[step]
            steps.append(step)
    return steps


def _dotted(steps: Sequence[Step]) -> str:
    text = ""
    for step in steps:
        text += f"[{step}]" if isinstance(step, int) else f".{step}"
    return text.lstrip(".")


def _fields_at(loc: Sequence[Step]) -> list[str]:
    """Names of the fields that the model at ``loc`` has."""
    found: list[Any] = [Study]
    for step in loc:
        inner: list[Any] = []
        for kind in found:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                if step in kind.model_fields:
                    inner += _members(kind.model_fields[str(step)].annotation)
            else:
                arguments = get_args(kind)
                inner += _members(arguments[-1]) if arguments else []
        found = inner or found
    models = [kind for kind in found if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return sorted({name for model in models for name in model.model_fields})


def _members(annotation: Any) -> list[Any]:
    """An annotation without Annotated and Union around it."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _members(get_args(annotation)[0])
    if origin in (Union, types.UnionType) or origin is typing.Union:
        return [inner for member in get_args(annotation) for inner in _members(member)]
    return [annotation]
