"""Makes the virtual environment of the project and installs it there, with its development tools.

Debian's python3 comes without ensurepip unless python3-venv is installed. The environment is then made
without pip, and pip itself is fetched with the system's pip or from the Python Packaging Authority.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request
import venv
from pathlib import Path

__all__ = ["main"]

GET_PIP = "https://bootstrap.pypa.io/get-pip.py"
OLDEST = (3, 11)


def _run(*command: str | Path) -> None:
    subprocess.run([str(part) for part in command], check=True)


def _install_pip(python: Path) -> None:
    """Put pip into an environment that has none."""
    if importlib.util.find_spec("ensurepip") is not None:
        _run(python, "-m", "ensurepip", "--upgrade", "--default-pip")
        return
    if importlib.util.find_spec("pip") is not None:
        _run(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "pip")
        return
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "get-pip.py"
        with urllib.request.urlopen(GET_PIP, timeout=60) as reply:
            script.write_bytes(reply.read())
        _run(python, script, "--quiet")


def _make(folder: Path) -> None:
    """Make the environment if need be and install the project with its tools."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=False, symlinks=True)
    if subprocess.run([python, "-m", "pip", "--version"], check=False, capture_output=True).returncode:
        _install_pip(python)
    _run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--editable", ".[dev]")


def main(folder: Path) -> int:
    """Make ``folder`` a working environment; 0 when done, 1 with one line of remedy when not."""
    if sys.version_info < OLDEST:
        print(f"contour needs Python 3.11 or newer, this is {sys.version.split()[0]}: make PYTHON=python3.11")
        return 1
    try:
        _make(folder)
    except urllib.error.URLError as error:
        print(f"cannot fetch pip ({error.reason}): install it with: apt install python3-venv")
        return 1
    except subprocess.CalledProcessError as error:
        print(
            f"setting up {folder} failed at: {' '.join(map(str, error.cmd))}; remove {folder} and try again"
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
