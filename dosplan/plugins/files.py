"""Plug-ins from files: a file and the modules that lie beside it, which it may import.

Each folder becomes a package of its own in ``sys.modules``, under a unique name, so that modules of
the same name in two folders do not collide. ``import helper`` in a file of the folder
finds ``helper.py`` or ``helper/__init__.py`` there before anything that is installed, as it would
where the file is run as a script; only ``dosplan`` and the packages of installed plug-ins are
always the installed ones. Everything else in the process imports as before.
"""

from __future__ import annotations

import ast
import builtins
import importlib.util
import sys
from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from dosplan.system.provenance import content_digest

_PREFIX: Final = "dosplan_plugin_"


class _Loader(SourceFileLoader):
    """Loads a module of a folder of plug-ins; never from bytecode, which may be outdated."""

    def __init__(self, fullname: str, path: str, folder: _Folder) -> None:
        super().__init__(fullname, path)
        self._folder = folder

    def get_code(self, fullname: str) -> Any:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)

    def exec_module(self, module: ModuleType) -> None:
        # The import statements of a module use the __import__ of its own __builtins__.
        module.__dict__["__builtins__"] = {
            **vars(builtins), "__import__": self._folder.import_module
        }  # fmt: skip
        super().exec_module(module)


class _Folder:
    """A folder that plug-ins were loaded from."""

    def __init__(self, path: Path, shared: frozenset[str]) -> None:
        self.path = path
        self.shared = shared
        self.package = _PREFIX + sha256(str(path).encode()).hexdigest()[:12]
        self._digests: dict[Path, str] = {}

    def import_module(
        self,
        name: str,
        globals: Mapping[str, object] | None = None,
        locals: Mapping[str, object] | None = None,
        fromlist: Sequence[str] = (),
        level: int = 0,
    ) -> ModuleType:
        """What ``import`` does in a module of the folder; the arguments of ``__import__``."""
        top = name.partition(".")[0]
        if level or not _is_neighbour(self.path, top, self.shared):
            return builtins.__import__(name, globals, locals, fromlist, level)
        found = builtins.__import__(f"{self.package}.{name}", globals, locals, fromlist)
        return found if fromlist else sys.modules[f"{self.package}.{top}"]

    def load(self, file: Path) -> ModuleType:
        """Imports a file of the folder, unless it is there and nothing was changed."""
        if any(self._digest(known) != digest for known, digest in self._digests.items()):
            self._forget()
        name = f"{self.package}.{_module_name(file)}"
        if name not in sys.modules:
            before = self._modules()
            try:
                self._import(file, name)
            except BaseException:
                for added in self._modules() - before:
                    del sys.modules[added]
                raise
        self._digests[file] = self._digest(file)
        return sys.modules[name]

    def _import(self, file: Path, name: str) -> None:
        package = ModuleType(self.package)
        package.__path__ = [str(self.path)]
        sys.modules.setdefault(self.package, package)
        loader = _Loader(name, str(file), self)
        spec = importlib.util.spec_from_file_location(name, file, loader=loader)
        if spec is None:
            raise ImportError(f"{file} is not a Python file")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses look a class's module up here.
        loader.exec_module(module)

    def _digest(self, file: Path) -> str:
        return content_digest(local_modules(file, self.shared))

    def _modules(self) -> set[str]:
        return {name for name in sys.modules if name.partition(".")[0] == self.package}

    def _forget(self) -> None:
        self._digests.clear()
        for name in self._modules():
            del sys.modules[name]


class _Finder:
    """Finds the modules of the folders' packages; one of ``sys.meta_path``."""

    def __init__(self) -> None:
        self.folders: dict[str, _Folder] = {}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """What the import system asks for."""
        folder = self.folders.get(fullname.partition(".")[0])
        spec = None if folder is None else PathFinder.find_spec(fullname, path, target)
        if folder is not None and spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(fullname, spec.loader.get_filename(fullname), folder)
        return spec


_FINDER: Final = _Finder()


def load_file(path: str, shared: frozenset[str]) -> ModuleType:
    """Imports a file.

    Args:
        path: The file.
        shared: Packages that are always the installed ones.

    Returns:
        Its module; the same as before where neither the file nor what it imports was changed.

    Raises:
        FileNotFoundError: There is no such file.
        Exception: Whatever the file raises.
    """
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    file = file.resolve()
    folder = _Folder(file.parent, shared)
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)
    return _FINDER.folders.setdefault(folder.package, folder).load(file)


def loaded_file(plugin: type[Any]) -> Path | None:
    """Names the file that a plug-in was loaded from by ``load_file``.

    Args:
        plugin: Its class.

    Returns:
        The file; None where the class is of an installed module.
    """
    if plugin.__module__.partition(".")[0] not in _FINDER.folders:
        return None
    file = getattr(sys.modules.get(plugin.__module__), "__file__", None)
    return None if file is None else Path(file)


def local_modules(file: Path, shared: frozenset[str]) -> list[Path]:
    """Names the files that a plug-in of a file consists of.

    They are read from the import statements, wherever these stand, so that one that runs late
    counts as well.

    Args:
        file: The file.
        shared: Packages that are always the installed ones.

    Returns:
        The file, and the modules of its folder that it imports, or that one of them does; sorted.
    """
    root = file.parent
    found: set[Path] = set()
    left = [file]
    while left:
        path = left.pop()
        if path in found:
            continue
        found.add(path)
        try:
            tree = ast.parse(path.read_bytes())
        except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
            continue  # Importing it says what is wrong.
        for name in _imported(tree, path, root):
            if _is_neighbour(root, name[0], shared):
                left.extend(_files(root, name))
    return sorted(found)


def _imported(tree: ast.AST, path: Path, root: Path) -> Iterator[tuple[str, ...]]:
    """The names that a module imports, from the folder's root on."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (tuple(alias.name.split(".")) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.parent.relative_to(root).parts
            start = package[: len(package) - node.level + 1] if node.level else ()
            module = (*start, *(node.module.split(".") if node.module else ()))
            yield from ((*module, alias.name) for alias in node.names)


def _files(root: Path, name: tuple[str, ...]) -> Iterator[Path]:
    """The files that an import of a dotted name runs."""
    for end in range(1, len(name) + 1):
        place = root.joinpath(*name[:end])
        for file in (place / "__init__.py", place.with_name(f"{place.name}.py")):
            if file.is_file():
                yield file


def _is_neighbour(folder: Path, name: str, shared: frozenset[str]) -> bool:
    """Whether a module of that name lies in the folder; a folder without __init__.py is none."""
    if name in shared or not name.isidentifier():
        return False
    return (folder / f"{name}.py").is_file() or (folder / name / "__init__.py").is_file()


def _module_name(file: Path) -> str:
    """A name that no other file of the folder has; that of the file, where it can be imported."""
    if file.stem.isidentifier():
        return file.stem
    digest = sha256(file.name.encode(errors="surrogatepass")).hexdigest()[:8]
    return f"{file.stem.replace('.', '_')}_{digest}"
