"""``studyapp simulate``: whole sessions with simulated observers on the virtual display, as fast as the machine can."""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tqdm import tqdm

from protocols.load import read_study
from stimuli.errors import InputError, problem
from studyapp.cli import JobFailed
from studyapp.ring import spawn_context
from studyapp.session_log import LogFailed

HELP = "K whole sessions with simulated observers on the virtual display, without clips"
EXAMPLE = "studyapp simulate demo --participants 12 --data data --seed 1"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--participants", type=int, required=True, metavar="K", help="slots FIRST to FIRST + K - 1")
    parser.add_argument("--first", type=int, default=1, metavar="N", help="first participant number (default 1)")
    parser.add_argument("--data", type=Path, default=Path("data"), metavar="DIR", help="session files go here")
    parser.add_argument("--seed", type=int, default=None, help="of the observers (default: the protocol's)")
    parser.add_argument("--observer", choices=("model", "pictures"), default="model",
                        help="model: the utilities of the protocol's observer; pictures: a metric of the frames shown, "
                             "from rendered clips")  # fmt: skip
    parser.add_argument("--store", default=None, metavar="DIR", help="clips, for --observer pictures")
    parser.add_argument("--jobs", type=int, default=None, metavar="N", help="processes (default: one a core)")


def run(args: argparse.Namespace) -> int:
    """Simulate, one file a session."""
    study, _ = read_study(args.protocol)
    if not 1 <= args.participants <= 10_000:
        raise InputError(problem("--participants", "number", args.participants, "1 to 10000"))
    if args.first < 1:
        raise InputError(problem("--first", "participant number", args.first, "a whole number from 1"))
    args.data.mkdir(parents=True, exist_ok=True)
    numbers = list(range(args.first, args.first + args.participants))
    seed = study.seed if args.seed is None else args.seed
    pictures = args.observer == "pictures"
    jobs = max(1, min(args.jobs or os.cpu_count() or 1, len(numbers)))
    shares = [numbers[job::jobs] for job in range(jobs)]
    bar = tqdm(total=len(numbers), unit="session", desc=f"simulating {study.study}", leave=False, disable=None)
    try:
        if jobs == 1:
            paths = simulate_share(args.protocol, numbers, str(args.data), seed, pictures, args.store)
            bar.update(len(paths))
        else:
            with ProcessPoolExecutor(jobs, mp_context=spawn_context()) as pool:
                waiting = [
                    pool.submit(simulate_share, args.protocol, s, str(args.data), seed, pictures, args.store)
                    for s in shares
                ]
                paths = []
                for share in waiting:
                    paths += share.result()
                    bar.update(len(paths) - bar.n)
    except LogFailed as error:
        raise JobFailed(str(error)) from error
    finally:
        bar.close()
    print(f"{len(paths)} sessions of {study.study} by simulated observers (seed {seed}) in {args.data}")
    return 0


def simulate_share(
    protocol: str, participants: list[int], folder: str, seed: int, pictures: bool = False, store: str | None = None
) -> list[str]:
    """Simulate these participants in this process; the paths of their session files."""
    from studyapp.simulate_session import Simulation

    simulation = Simulation(protocol, seed, pictures, store)
    return [str(simulation.session(number, Path(folder))) for number in participants]
