"""``python -m analysis DATA... --report report.html``: session files to statistics and one offline page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from stimuli.errors import InputError


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m analysis",
        description="Statistics and report from session files (files, or folders of *.sqlite).",
        epilog="example: python -m analysis data --report report.html --json results.json\n"
        "also: python -m analysis power PROTOCOL, python -m analysis csv DATA... --out DIR, "
        "python -m analysis bids DATA... --out DIR",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("data", nargs="+", metavar="DATA", help="session files, or folders that hold them")
    parser.add_argument("--report", metavar="FILE", required=True, help="the page to write (.html)")
    parser.add_argument("--json", metavar="FILE", help="every number of the page (default: none)")
    parser.add_argument("--tables", metavar="DIR", help="the tables as CSV and LaTeX")
    parser.add_argument(
        "--blind",
        action="store_true",
        help="exclusions, timing and gaze with coded condition names; locks the exclusions (exclusions.lock.json)",
    )
    parser.add_argument("--registration", metavar="FILE", help="NAME.freeze.json: says what differs from it")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    return parser


def _report(argv: Sequence[str]) -> int:
    """Write the report; returns the exit code."""
    from analysis.write_report import write_report

    args = _parser().parse_args(argv)
    written = write_report(
        args.data,
        Path(args.report),
        json_path=args.json,
        tables=args.tables,
        blind=args.blind,
        registration=args.registration,
        show_progress=not args.quiet,
    )
    for path in written:
        print(path)
    return 0


def _export(kind: str, argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog=f"python -m analysis {kind}")
    parser.add_argument("data", nargs="+", metavar="DATA", help="session files, or folders that hold them")
    parser.add_argument(
        "--out", metavar="DIR", required=True, help="the folder to write (new, or made by an earlier export)"
    )
    args = parser.parse_args(argv)
    if kind == "bids":
        from analysis.bids import export_bids as export
    else:
        from analysis.csv_export import export_csv as export
    print(export(args.data, Path(args.out)))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Report (default), or the subcommands power, csv and bids. Exit codes as in `studyapp.cli`: 0, 1, 2."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        if arguments[:1] == ["power"]:
            from analysis.power_command import main as power

            return int(power(arguments[1:]))
        if arguments[:1] in (["csv"], ["bids"]):
            return _export(arguments[0], arguments[1:])
        return _report(arguments)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"analysis: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("analysis: interrupted; nothing half-written is kept", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
