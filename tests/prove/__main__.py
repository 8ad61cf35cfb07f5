"""``make prove``: every module of full-length evidence, one after another, each in its own process."""

from __future__ import annotations

import pkgutil
import subprocess
import sys

from tests import prove


def main() -> int:
    """Run them all; 1 where one failed."""
    failed = []
    for name in sorted(info.name for info in pkgutil.iter_modules(prove.__path__) if info.name != "__main__"):
        print(f"prove: {name}", flush=True)
        if subprocess.run([sys.executable, "-m", f"tests.prove.{name}"], check=False).returncode:
            failed.append(name)
    print(f"prove: {'failed: ' + ', '.join(failed) if failed else 'all held'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
