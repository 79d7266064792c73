"""What is compiled after a warm-up, seen in a process of its own: in this one it may have been compiled before."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys
from {warmup} import warmup

def compiled():
    return {{
        f"{{module}}.{{name}}": len(value.signatures)
        for module, content in list(sys.modules.items()) if module.startswith("{package}.")
        for name, value in vars(content).items() if hasattr(value, "signatures") and hasattr(value, "py_func")
    }}

warmup()
before = compiled()
assert before
{work}
print(sorted(name for name, count in compiled().items() if count > before.get(name, count)))
"""


def compiled_after(warmup: str, package: str, work: str, folder: Path) -> str:
    """Functions of a package that work still compiles after its module `warmup`, as a printed list.

    The work may import the helpers of `folder`.
    """
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(warmup=warmup, package=package, work=work)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(folder)},
        cwd=Path(__file__).parents[1],
        check=False,
    )
    return done.stdout.strip() or done.stderr
