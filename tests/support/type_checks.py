"""Types and shapes of the package are checked while testing; each function gets its checks when it is first called.

jaxtyping's own import hook makes the checks of every function at import, most of which a process of the tests never
calls, and those of a nested function whenever the one around it runs; each call checks the arguments twice. Here equal
annotations share one check, and annotations with names that are only known after the import are checked too.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import functools
import hashlib
import importlib.abc
import inspect
import io
import itertools
import sys
import types
import typing
from collections.abc import Callable, Iterable
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from typing import Any, TypeVar

import jaxtyping
from beartype import beartype
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import AbstractArray, TypeCheckError, jaxtyped

_Target = TypeVar("_Target")
_Check = Callable[[Any], None]
_Form = tuple[Any, ...]

#: Bytecode of checked modules is kept beside the plain one, and made anew after a change of this file.
_TAG = "checked-" + hashlib.md5(Path(__file__).read_bytes(), usedforsecurity=False).hexdigest()[:8]


def check_types_of(package: str, but: Iterable[str]) -> None:
    """Checks all modules of ``package`` that are imported from now on, ``but`` these and what is in them."""
    already = [name for name in sys.modules if name.startswith(package + ".")]
    if already:
        raise RuntimeError(f"types of these cannot be checked, which are imported already: {', '.join(already)}")
    sys.meta_path.insert(0, _Finder(package + ".", tuple(but)))


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the modules whose types are checked."""

    def __init__(self, prefix: str, unchecked: tuple[str, ...]) -> None:
        self._prefix = prefix
        self._unchecked = unchecked

    def find_spec(self, fullname: str, path: Any, target: types.ModuleType | None = None) -> ModuleSpec | None:
        if not fullname.startswith(self._prefix) or f"{fullname}.".startswith(tuple(f"{n}." for n in self._unchecked)):
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(fullname, spec.loader.path)
        return spec


class _Loader(SourceFileLoader):
    """Loads a module with :func:`checked` on its functions and dataclasses."""

    def source_to_code(self, data: Any, path: Any, **options: Any) -> types.CodeType:  # pyright: ignore
        tree = ast.parse(data, path)
        first = sum(1 for _ in itertools.takewhile(_stays_first, tree.body))
        tree.body.insert(first, ast.ImportFrom(__name__, [ast.alias("checked", "_checked_types")], 0))
        _Decorating().visit(tree)
        return compile(ast.fix_missing_locations(tree), path, "exec", dont_inherit=True)

    def exec_module(self, module: types.ModuleType) -> None:
        super().exec_module(module)
        _NAMES[module.__name__] = dict(vars(module))

    def get_data(self, path: str) -> bytes:
        return super().get_data(_own_bytecode(path))

    def set_data(self, path: str, data: Any, *, _mode: int = 0o666) -> None:
        super().set_data(_own_bytecode(path), data, _mode=_mode)


def _stays_first(node: ast.stmt) -> bool:
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return docstring or (isinstance(node, ast.ImportFrom) and node.module == "__future__")


def _own_bytecode(path: str) -> str:
    return f"{path.removesuffix('.pyc')}.{_TAG}.pyc" if path.endswith(".pyc") else path


class _Decorating(ast.NodeVisitor):
    """Puts the decorator next to a function, beneath its others, and above all others of a class."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        node.decorator_list.append(ast.copy_location(ast.Name("_checked_types", ast.Load()), node))
        self.generic_visit(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        if node.decorator_list:
            node.decorator_list.insert(0, ast.copy_location(ast.Name("_checked_types", ast.Load()), node))
        self.generic_visit(node)


def checked(target: _Target) -> _Target:
    """The function, or the dataclass, with its arguments and results checked against their annotations.

    Raises:
        TypeCheckError: by the function, at a value that is not of its annotation, or at two shapes that contradict
            each other.
    """
    if isinstance(target, types.FunctionType):
        return typing.cast(_Target, _checked(target))
    made = vars(target).get("__init__")
    if dataclasses.is_dataclass(target) and isinstance(made, types.FunctionType):
        target.__init__ = _checked(made)  # pyright: ignore[reportAttributeAccessIssue]
    return target


def _checked(function: types.FunctionType) -> Callable[..., Any]:
    if not function.__annotations__ or hasattr(function, "__wrapped__"):
        return function
    code = id(function.__code__)

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        checks = _CHECKS.get(code) or _checks_of(function)
        if not checks.shapes:
            checks.arguments(args, kwargs)
            result = function(*args, **kwargs)
            checks.result(result)
            return result
        form = checks.form(args, kwargs)
        if form is not None and form in checks.known:
            checks.arguments(args, kwargs, shapes=False)
            result = function(*args, **kwargs)
            if checks.form_of_result(result) in checks.known[form]:
                checks.result(result, shapes=False)
                return result
            with jaxtyped("context"):
                checks.arguments(args, kwargs)
                checks.result(result)
        else:
            with jaxtyped("context"):
                checks.arguments(args, kwargs)
                result = function(*args, **kwargs)
                checks.result(result)
        if form is not None:
            checks.known.setdefault(form, set()).add(checks.form_of_result(result))
        return result

    return wrapper


class _Checks:
    """The checks of one function, by the order and by the names of its parameters."""

    def __init__(self, function: types.FunctionType) -> None:
        #: Kept, or another function's code could get its number.
        self.code = function.__code__
        self._function = f"{function.__module__}.{function.__qualname__}"
        hints = _hints(function)
        #: Whether sizes of axes are to be remembered from one argument to the next.
        self.shapes = any(_has_shape(hint) for hint in hints.values())
        #: Forms of arguments that passed, and those of their results: whether shapes fit depends on nothing else.
        self.known: dict[_Form, set[_Form]] = {}
        self._of_forms = {name for name, hint in hints.items() if _has_shape(hint)}
        self._all_of_forms = all(_is_of_forms(hints[name]) for name in self._of_forms)
        self._result = _check(hints["return"], result=True) if "return" in hints else None
        parameters = inspect.signature(function).parameters.values()
        named = [(p.kind, p.name, _check(hints[p.name]) if p.name in hints else None) for p in parameters]
        self._in_order = [(name, check) for kind, name, check in named if kind in _BY_ORDER]
        self._by_name = {name: check for kind, name, check in named if kind in _BY_NAME}
        self._rest = next((check for kind, _, check in named if kind is inspect.Parameter.VAR_POSITIONAL), None)
        self._rest_by_name = next((check for kind, _, check in named if kind is inspect.Parameter.VAR_KEYWORD), None)

    def form(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> _Form | None:
        """Types and shapes of the arguments whose shapes are annotated; None if arrays may be anywhere in them."""
        if not self._all_of_forms or self._rest is not None or self._rest_by_name is not None:
            return None
        in_order = [
            _form(value) for (name, _), value in zip(self._in_order, args, strict=False) if name in self._of_forms
        ]
        return *in_order, *((name, _form(value)) for name, value in kwargs.items() if name in self._of_forms)

    def form_of_result(self, result: Any) -> _Form:
        return _form(result) if "return" in self._of_forms else ()

    def arguments(self, args: tuple[Any, ...], kwargs: dict[str, Any], *, shapes: bool = True) -> None:
        """Checks what the function is called with, or what of it has no shapes."""
        done = () if shapes else self._of_forms
        name = ""
        try:
            for (name, check), value in zip(self._in_order, args, strict=False):
                if check is not None and name not in done:
                    check(value)
            if self._rest is not None:
                for value in args[len(self._in_order) :]:
                    self._rest(value)
            if kwargs:
                for name, check in self._by_name.items():
                    if check is not None and name in kwargs and name not in done:
                        check(kwargs[name])
                if self._rest_by_name is not None:
                    for name in kwargs.keys() - self._by_name.keys():
                        self._rest_by_name(kwargs[name])
        except BeartypeCallHintViolation as violation:
            raise TypeCheckError(self._told(f"argument {name}", violation)) from None

    def result(self, value: Any, *, shapes: bool = True) -> None:
        """Checks what the function returned, or that alone which has no shapes."""
        if self._result is not None and (shapes or "return" not in self._of_forms):
            try:
                self._result(value)
            except BeartypeCallHintViolation as violation:
                raise TypeCheckError(self._told("result", violation)) from None

    def _told(self, what: str, violation: Exception) -> str:
        sizes = io.StringIO()
        with contextlib.redirect_stdout(sizes):
            jaxtyping.print_bindings()
        return f"{self._function}, {what}: {violation}\n{sizes.getvalue()}".rstrip()


#: Parameters that arguments reach by their order, and by their name.
_BY_ORDER = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)

#: By the number of the function's code: nested functions are made anew at each call around them, of the same code.
_CHECKS: dict[int, _Checks] = {}
#: What each module's names meant at the end of its import, before tests put other things in their place.
_NAMES: dict[str, dict[str, Any]] = {}
#: By what the annotation says.
_BY_HINT: dict[Any, _Check | None] = {}


def _checks_of(function: types.FunctionType) -> _Checks:
    return _CHECKS.setdefault(id(function.__code__), _Checks(function))


def _hints(function: types.FunctionType) -> dict[str, Any]:
    """What the annotations mean; those that name what only type checkers import are left out."""
    try:
        return _evaluated(function, function.__annotations__)
    except Exception:  # whatever an expression may raise
        hints = {}
        for name, annotation in function.__annotations__.items():
            with contextlib.suppress(Exception):
                hints.update(_evaluated(function, {name: annotation}))
        return hints


def _evaluated(function: types.FunctionType, annotations: dict[str, Any]) -> dict[str, Any]:
    def bare() -> None: ...

    bare.__annotations__ = dict(annotations)
    names = function.__globals__
    return typing.get_type_hints(bare, _NAMES.get(names["__name__"], names), include_extras=True)


def _check(hint: Any, *, result: bool = False) -> _Check | None:
    key = (_key(hint), result)
    try:
        if key not in _BY_HINT:
            _BY_HINT[key] = _generated(hint, result=result)
        return _BY_HINT[key]
    except TypeError:  # an annotation that is not hashable
        return _generated(hint, result=result)


def _generated(hint: Any, *, result: bool) -> _Check | None:
    if hint is Any or hint is object or isinstance(hint, typing.ParamSpecArgs | typing.ParamSpecKwargs):
        return None

    def check(value: Any) -> Any:
        return value

    check.__annotations__ = {"return" if result else "value": hint}
    return beartype(check)


def _key(hint: Any) -> Any:
    """Equal for annotations that say the same: jaxtyping makes a class of each."""
    if _is_shape(hint):
        return (hint.dtype, hint.array_type, hint.dim_str)
    parts = typing.get_args(hint)
    if any(_has_shape(part) for part in parts):
        return (typing.get_origin(hint), *(_key(part) for part in parts))
    return hint


def _has_shape(hint: Any) -> bool:
    return _is_shape(hint) or any(_has_shape(part) for part in typing.get_args(hint))


def _is_shape(hint: Any) -> bool:
    # In Python 3.10, list[int] passes for a class.
    return isinstance(hint, type) and not isinstance(hint, types.GenericAlias) and issubclass(hint, AbstractArray)


def _is_of_forms(hint: Any) -> bool:
    """Whether values fit by their forms alone: arrays, tuples of them, None."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType, tuple):
        return all(_is_of_forms(part) for part in typing.get_args(hint))
    return hint is type(None) or _is_shape(hint)


def _form(value: Any) -> _Form:
    if type(value) is tuple:
        return tuple(_form(part) for part in value)
    return (type(value), getattr(value, "dtype", None), getattr(value, "shape", None))
