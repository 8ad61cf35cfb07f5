"""The command line: ``studyapp COMMAND``. A command is a module in `studyapp.commands`; what is there is listed.

Exit codes: 0 done, 1 the job failed, 2 the user's input is wrong (one line each, no traceback).
"""

from __future__ import annotations

import argparse
import pkgutil
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

from stimuli.errors import InputError
from studyapp import commands


class JobFailed(RuntimeError):
    """The input was right and the job still failed; printed in one line, exit code 1."""


def command_names() -> list[str]:
    """Every command there is, in alphabetical order."""
    return sorted(info.name for info in pkgutil.iter_modules(commands.__path__))


def _load(name: str) -> ModuleType:
    return import_module(f"studyapp.commands.{name}")


def _usage() -> str:
    lines = ["usage: studyapp COMMAND [...]     (studyapp COMMAND --help for each, with an example)", ""]
    lines += [f"  {name:<12} {_load(name).HELP}" for name in command_names()]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_usage())
        return 0
    name, rest = arguments[0], arguments[1:]
    if name not in command_names():
        print(f"studyapp: unknown command: got {name!r}, wanted one of {' | '.join(command_names())}", file=sys.stderr)
        return 2
    module = _load(name)
    parser = argparse.ArgumentParser(
        prog=f"studyapp {name}",
        description=module.HELP,
        epilog=f"example: {module.EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.configure(parser)
    try:
        return int(module.run(parser.parse_args(rest)))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except JobFailed as error:
        print(f"studyapp {name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"studyapp {name}: interrupted; what was finished is kept", file=sys.stderr)
        return 1
    except BrokenPipeError:
        sys.stderr.close()
        return 1


if __name__ == "__main__":
    sys.exit(main())
