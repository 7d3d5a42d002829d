"""What holds for every module: names, sizes, and what importing it costs."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import contour

ROOT = Path(contour.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
MODULES = [".".join(("contour", *f.relative_to(ROOT).with_suffix("").parts)) for f in FILES]
LONGEST_MODULE = 500
LONGEST_FUNCTION = 80


def _name(module):
    return module.removesuffix(".__init__")


@pytest.mark.parametrize("module,file", list(zip(MODULES, FILES, strict=True)), ids=MODULES)
def test_all_is_complete(module, file):
    """__all__ names what exists, and every public function, class and capital constant with a docstring."""
    loaded = importlib.import_module(_name(module))
    missing = [name for name in loaded.__all__ if not hasattr(loaded, name)]
    assert not missing
    tree = ast.parse(file.read_text(encoding="utf-8"))
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    public = {node.name for node in tree.body if isinstance(node, kinds) and not node.name.startswith("_")}
    assert public <= set(loaded.__all__)


@pytest.mark.parametrize("file", FILES, ids=MODULES)
def test_modules_and_functions_stay_short(file):
    """A module is one thing that fits in a head; so is a function."""
    source = file.read_text(encoding="utf-8")
    assert len(source.splitlines()) <= LONGEST_MODULE
    functions = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    long = {f.name: f.end_lineno - f.lineno for f in functions if f.end_lineno - f.lineno > LONGEST_FUNCTION}
    assert not long


def _loaded_by(statement):
    """Names of the modules that a fresh interpreter has after ``statement``."""
    program = f"{statement}\nimport sys\nprint('\\n'.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120
    )
    return {name.partition(".")[0] for name in done.stdout.split()}


def test_importing_the_package_loads_nothing_heavy():
    """``import contour`` costs no numpy, and the command line no mesh library before it knows what to do."""
    assert not _loaded_by("import contour") & {"numpy", "scipy", "trimesh", "pyvista", "vtk", "vtkmodules"}
    assert not _loaded_by("import contour.cli") & {
        "numpy",
        "scipy",
        "trimesh",
        "pyvista",
        "vtk",
        "vtkmodules",
    }


def test_no_module_draws_when_imported():
    """VTK may crash where OpenGL is absent: no module loads it by being imported."""
    statement = "\n".join(f"import {_name(module)}" for module in MODULES)
    assert not _loaded_by(statement) & {"pyvista", "vtk", "vtkmodules"}


def test_core_needs_numpy_and_scipy_alone():
    """Mechanics, estimation and tracing run without the mesh and link libraries."""
    core = [
        m
        for m in ("antenna", "frames", "contact", "elastica", "tracing", "model")
        if (ROOT / f"{m}.py").exists()
    ]
    statement = "\n".join(f"import contour.{module}" for module in core)
    assert not _loaded_by(statement) & {"trimesh", "embreex", "pymodbus", "rich", "cyclopts", "matplotlib"}


def test_every_source_is_listed():
    """Keys such as Kaneko1998 in code and documents resolve in docs/references.md."""
    root = ROOT.parent
    listed = set(
        re.findall(
            r"^\| (\w+) \|", (root / "docs" / "references.md").read_text(encoding="utf-8"), re.MULTILINE
        )
    )
    texts = [*FILES, *(root / "docs").rglob("*.md"), root / "README.md"]
    cited = {
        key
        for text in texts
        for key in re.findall(r"\b[A-Z][a-z]+(?:19|20)\d\d\b", text.read_text(encoding="utf-8"))
    }
    assert cited <= listed


def test_every_document_link_leads_somewhere():
    """Relative links of README and docs point at files that are there."""
    root = ROOT.parent
    for page in (root / "README.md", root / "CHANGELOG.md", *(root / "docs").rglob("*.md")):
        for link in re.findall(r"\]\((?!https?:)([^)#\s]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
