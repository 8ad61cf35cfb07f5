"""What the report and the exports need from the protocol and lab texts that a session stores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from analysis.sessions import Session


def protocol_of(session: Session) -> Mapping[str, Any]:
    """The session's protocol as plain mappings; empty where its text is absent or no YAML mapping."""
    return _mapping(session.header.get("protocol_text"))


def lab_of(session: Session) -> Mapping[str, Any]:
    """The session's lab file as plain mappings; empty where the room was undeclared."""
    return _mapping(session.header.get("lab_text"))


def _mapping(text: Any) -> Mapping[str, Any]:
    if not isinstance(text, str) or not text.strip():
        return {}
    try:
        # A protocol that extends another is stored as both, the widest first.
        documents = [one for one in YAML(typ="safe", pure=True).load_all(text) if isinstance(one, Mapping)]
    except YAMLError:
        return {}
    return {key: value for document in documents for key, value in document.items()}


def title_of(sessions: Sequence[Session]) -> str:
    """The study's title, its name where it has none."""
    title = protocol_of(sessions[0]).get("title")
    return str(title or sessions[0].header.get("study") or "study")


def replication_of(sessions: Sequence[Session]) -> Mapping[str, Any] | None:
    """The protocol's statement of what it repeats (of, kind, deviations), if it makes one."""
    stated = protocol_of(sessions[0]).get("replication")
    return stated if isinstance(stated, Mapping) else None


def adaptive_blocks(sessions: Sequence[Session]) -> dict[str, str]:
    """Blocks whose trials depend on the answers before, and how: staircase, quest_plus or active_pairs."""
    found: dict[str, str] = {}
    blocks = protocol_of(sessions[0]).get("blocks")
    for block in blocks if isinstance(blocks, Sequence) else ():
        varied = block.get("adaptive") if isinstance(block, Mapping) else None
        if isinstance(varied, Mapping):
            found[str(block.get("name"))] = str(varied.get("kind"))
    return found


def level_order(sessions: Sequence[Session], factor: str) -> list[str]:
    """The levels of ``factor`` in the order in which a block of the protocol lists them; empty where none does."""
    blocks = protocol_of(sessions[0]).get("blocks")
    for block in blocks if isinstance(blocks, Sequence) else ():
        factors = block.get("factors") if isinstance(block, Mapping) else None
        levels = factors.get(factor) if isinstance(factors, Mapping) else None
        if isinstance(levels, (Mapping, list)) and levels:
            return [str(level) for level in levels]
    return []


def screen_of(session: Session) -> dict[str, Any]:
    """Screen geometry: size_px, width_m, height_m, distance_m; the lab file's display before the protocol's.

    Only what is stated: absent keys were stated nowhere. Height follows from square pixels where the protocol alone
    gives a width.
    """
    found: dict[str, Any] = {}
    for source in (protocol_of(session).get("display"), lab_of(session).get("display")):
        if isinstance(source, Mapping):
            keys = ("size_px", "width_m", "height_m", "distance_m")
            found.update({key: source[key] for key in keys if source.get(key) is not None})
    certificate = session.header.get("certificate") or {}
    if certificate.get("size_px"):
        found["size_px"] = list(certificate["size_px"])
    if "height_m" not in found and {"width_m", "size_px"} <= found.keys():
        found["height_m"] = float(found["width_m"]) * found["size_px"][1] / found["size_px"][0]
    return found
