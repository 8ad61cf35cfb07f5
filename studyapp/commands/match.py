"""``studyapp match``: solve the knobs that make conditions equal, by measurement, into NAME.match.yaml."""

from __future__ import annotations

import argparse
from pathlib import Path

from tqdm import tqdm

from protocols.load import library_path, match_file, read_unmatched
from protocols.match_lock import with_lock, write_lock
from stimuli.errors import InputError, problem

HELP = "make conditions equal in cost or quality, by measurement; writes NAME.match.yaml"
EXAMPLE = "studyapp match four_techniques"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--size", default=None, metavar="WxH",
                        help="pixels to measure at (default: the protocol's shape within 128 px; its own size where "
                             "milliseconds are matched)")  # fmt: skip
    parser.add_argument("--frames", type=int, default=16, metavar="N", help="refreshes measured (default 16)")
    parser.add_argument("--spp", type=int, default=16, metavar="N", help="samples of the gold standard (default 16)")


def run(args: argparse.Namespace) -> int:
    """Solve, write the lock, say what mismatch remains; 1 where some condition is not within its tolerance."""
    from studyapp.commands.tradeoff import size
    from studyapp.match_conditions import bench_of, solve, told

    study, _ = read_unmatched(args.protocol)
    if not study.match:
        raise InputError(problem(args.protocol, "match", "nothing", "match: [...] in the protocol"))
    if args.frames < 1 or args.spp < 1:
        raise InputError(problem("match", "--frames, --spp", f"{args.frames}, {args.spp}", "at least 1 each"))
    wanted = None if args.size is None else size(args.size)
    bench = bench_of(study, library_path(args.protocol).parent, wanted, args.frames, args.spp)
    with tqdm(desc="match", unit="setting", leave=False, disable=None) as bar:

        def step(said: str) -> None:
            bar.set_postfix_str(said[:60], refresh=False)
            bar.update()

        bench.progress = step
        lock = solve(study, bench)
    path: Path = match_file(args.protocol)
    with_lock(study, lock, path)  # what a technique refuses is not written
    write_lock(path, lock)
    print("\n".join(told(lock, study)))
    matched = all(row.matched for rows in lock.found for row in rows)
    print(f"{path}: {len(lock.knobs)} knobs" + ("" if matched else "; a mismatch remains, and the report says so"))
    return 0 if matched else 1
