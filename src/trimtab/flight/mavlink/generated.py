"""Generation of code for a MAVLink dialect: a Python module for pymavlink's tools, and C headers for a microcontroller.

MAVLink's own generator writes both from the XML definitions. So a program at the other end of the link does not need
trimtab.
"""

import contextlib
import hashlib
import importlib.util
import io
import os
import sys
import tempfile
import threading
from pathlib import Path
from types import ModuleType
from typing import Any

from trimtab.core.cache_folder import cache_folder
from trimtab.core.errors import InputError, install_command
from trimtab.flight.mavlink.dialect import Dialect

NAME = "trimtab"
GENERATOR_LOCK = threading.Lock()
"""Lock for MAVLink's generator, whose printed output is captured for the whole process."""


def load_python_module(dialect: Dialect) -> ModuleType:
    """Return the dialect as a Python module for pymavlink. The module is generated once and kept in the user's
    cache."""
    generator = load_generator()
    from pymavlink import __version__

    content = hashlib.sha256(f"{__version__}\n{dialect.text}".encode()).hexdigest()[:24]
    name = f"trimtab_dialect_{content}"
    with GENERATOR_LOCK, contextlib.ExitStack() as stack:
        if name in sys.modules:
            return sys.modules[name]
        try:
            file = cache_folder("dialects") / f"{name}.py"
        except OSError:  # without a cache, each process generates the module
            file = Path(stack.enter_context(tempfile.TemporaryDirectory())) / f"{name}.py"
        if not file.exists():
            file = _make_module(generator, dialect, file, stack)
        spec = importlib.util.spec_from_file_location(name, file)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        sys.modules[name] = module
    return module


def _make_module(generator: Any, dialect: Dialect, file: Path, stack: contextlib.ExitStack) -> Path:
    """Write the module to a temporary file, then rename the file, because two processes may write the same module at
    the same time."""
    own = Path(stack.enter_context(tempfile.TemporaryDirectory())) / file.name
    _run_generator(generator, dialect, own, "Python")
    with contextlib.suppress(OSError):  # a full or read-only cache
        descriptor, beside = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
        try:
            with os.fdopen(descriptor, "wb") as copy:
                copy.write(own.read_bytes())
            os.replace(beside, file)
        except OSError:
            os.unlink(beside)
            raise
        return file
    return own


def write_c_headers(dialect: Dialect, folder: Path) -> Path:
    """Write the dialect's C headers into a folder. Return the folder to include, which contains trimtab/mavlink.h."""
    generator = load_generator()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with GENERATOR_LOCK:
            _run_generator(generator, dialect, folder, "C")
    except OSError as error:
        problem = f"the folder cannot be written: {error.strerror or error}"
        raise InputError(f"C headers in '{folder}'", problem, fix="choose a folder that you can write") from None
    return folder


def load_generator() -> Any:
    """Return the module of MAVLink's own generator, an optional dependency. Raise InputError if the generator is not
    installed."""
    try:
        from pymavlink.generator import mavgen
    except ImportError:
        problem = "MAVLink's generator is not installed"
        raise InputError("dialect", problem, fix=install_command("wire")) from None
    return mavgen


def _run_generator(generator: Any, dialect: Dialect, output: Path, language: str) -> None:
    with tempfile.TemporaryDirectory() as own, contextlib.redirect_stdout(io.StringIO()) as said:
        source = Path(own) / f"{NAME}.xml"
        source.write_text(dialect.text, "utf-8")
        options = generator.Opts(str(output), wire_protocol="2.0", language=language, validate=False)
        success = generator.mavgen(options, [str(source)])
    if not success:
        raise InputError("dialect", f"MAVLink's generator failed: {said.getvalue()[-300:]}", fix="rename the fields")
