"""Wrong types and shapes are refused while testing, by every function of the package that has annotations."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import type_checks
from jaxtyping import TypeCheckError

from depthmocap.geometry import DepthCamera
from depthmocap.geometry.transforms import transform_points

MODULE = '''"""Functions of each kind."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

if TYPE_CHECKING:
    from depthmocap.nowhere import Unknown


def weighted(points: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
    return points * weights[:, None]


def optional(points: Float[np.ndarray, "n 3"] | None = None, *, chosen: Bool[np.ndarray, "n"] | None = None) -> int:
    return 0


def wrong_result(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return points[1:]


def tupled(points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 3"], int]:
    return points[1:], 1


def many(*points: Float[np.ndarray, "n 3"], **weights: float) -> None: ...


def number(value: int, later: Later | None = None, unknown: Unknown = None) -> str:
    return "" if value else 0


def around(size: int) -> int:
    def nested(size: int) -> int:
        return size
    return nested(str(size))


def numbers(points: Float[np.ndarray, "n 3"]) -> Iterator[int]:
    yield len(points)


@contextlib.contextmanager
def context(value: int) -> Iterator[int]:
    yield value


@functools.lru_cache
def cached(value: int) -> int:
    return value


def either(points: Float[np.ndarray, "n 3"], short: bool) -> tuple[Float[np.ndarray, "n 3"], None]:
    return points[1:] if short else points, None


def remembered(later: Later | None) -> None: ...


def takes(function: Callable[[int], Any]) -> None: ...


@dataclass(frozen=True)
class Later:
    points: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, "n"]
    names: tuple[str, ...] = ()
    more: list[int] = field(default_factory=list)

    @property
    def first(self) -> int:
        return self.names[0]

    @classmethod
    def made(cls, count: int) -> Later:
        return cls(np.zeros((count, 3)), np.zeros(count))

    @staticmethod
    def doubled(count: int) -> int:
        return 2 * count
'''


@pytest.fixture(scope="module")
def module(tmp_path_factory):
    folder = tmp_path_factory.mktemp("package")
    (folder / "checked_package").mkdir()
    (folder / "checked_package" / "__init__.py").touch()
    (folder / "checked_package" / "functions.py").write_text(MODULE)
    (folder / "checked_package" / "plain.py").write_text(MODULE)
    finders = list(sys.meta_path)
    sys.path.insert(0, str(folder))
    type_checks.check_types_of("checked_package", but=("checked_package.plain",))
    try:
        from checked_package import functions, plain  # pyright: ignore

        yield functions, plain
    finally:
        sys.path.remove(str(folder))
        sys.meta_path[:] = finders
        for name in [name for name in sys.modules if name.startswith("checked_package")]:
            del sys.modules[name]


def points(count: int) -> np.ndarray:
    return np.zeros((count, 3))


RIGHT = {
    "shapes": lambda f: f.weighted(points(4), np.zeros(4)),
    "shapes by name": lambda f: f.weighted(weights=np.zeros(4), points=points(4)),
    "none": lambda f: f.optional(None),
    "several": lambda f: f.many(points(2), points(2), left=0.5),
    "a name that only type checkers import": lambda f: f.number(1, None, 3),
    "a class that is defined later": lambda f: f.number(1, f.Later.made(2)),
    "a class method": lambda f: f.Later.made(2),
    "a generator": lambda f: list(f.numbers(points(2))),
    "a function": lambda f: f.takes(lambda value: value),
}
WRONG = {
    "number of coordinates": (lambda f: f.weighted(np.zeros((4, 2)), np.zeros(4)), "weighted, argument points"),
    "type of numbers": (lambda f: f.weighted(points(4), np.zeros(4, int)), "weighted, argument weights"),
    "two lengths": (lambda f: f.weighted(points(4), np.zeros(5)), "weighted, argument weights(.|\n)*n=4"),
    "two lengths by name": (lambda f: f.weighted(weights=np.zeros(5), points=points(4)), "weighted, argument weights"),
    "an optional one": (lambda f: f.optional(np.zeros((4, 2))), "optional, argument points"),
    "two optional ones": (lambda f: f.optional(points(4), chosen=np.zeros(5, bool)), "optional, argument chosen"),
    "a result": (lambda f: f.wrong_result(points(4)), "wrong_result, result"),
    "part of a result": (lambda f: f.tupled(points(4)), "tupled, result"),
    "the second of several": (lambda f: f.many(points(4), points(5)), "many, argument"),
    "one of several by name": (lambda f: f.many(left="right"), "many, argument left"),
    "no array": (lambda f: f.weighted([[0.0, 0.0, 0.0]], np.zeros(1)), "weighted, argument points"),
    "a plain type": (lambda f: f.number("1"), "number, argument value"),
    "a plain result": (lambda f: f.number(0), "number, result"),
    "a class that is defined later": (lambda f: f.number(1, 2), "number, argument later"),
    "a nested function": (lambda f: f.around(1), "nested, argument size"),
    "a generator": (lambda f: f.numbers(np.zeros((4, 2))), "numbers, argument points"),
    "a context": (lambda f: f.context("1"), "context, argument value"),
    "a decorated function": (lambda f: f.cached("1"), "cached, argument value"),
    "a dataclass": (lambda f: f.Later(points(4), np.zeros(5)), "Later.__init__, argument weights"),
    "a part of a dataclass": (lambda f: f.Later(points(1), np.zeros(1), (1,)), "Later.__init__, argument names"),
    "a class method": (lambda f: f.Later.made("1"), "made, argument count"),
    "a static method": (lambda f: f.Later.doubled("1"), "doubled, argument count"),
    "a property": (lambda f: f.Later(points(1), np.zeros(1), ("a",)).first, "first, result"),
    "a function": (lambda f: f.takes(1), "takes, argument function"),
}


@pytest.mark.parametrize("call", RIGHT.values(), ids=RIGHT.keys())
def test_what_fits_is_let_through(module, call):
    call(module[0])


@pytest.mark.parametrize("call, told", WRONG.values(), ids=WRONG.keys())
def test_what_does_not_fit_is_refused(module, call, told):
    for _ in range(2):  # the second call as the first, which makes the checks
        with pytest.raises(TypeCheckError, match=told):
            call(module[0])


def test_what_is_left_out_is_not_checked(module):
    assert module[1].number("1") == ""
    assert module[1].weighted(np.zeros((4, 2)), np.zeros(4)).shape == (4, 2)


def test_names_mean_what_they_meant_at_import(module, monkeypatch):
    monkeypatch.setattr(module[0], "Later", len)
    module[0].remembered(None)


def test_sizes_are_of_one_call_alone(module):
    for count in (3, 4):
        assert len(module[0].weighted(points(count), np.zeros(count))) == count


def test_what_passed_once_is_checked_as_well_afterwards(module):
    functions = module[0]
    for _ in range(2):
        functions.weighted(points(4), np.zeros(4))
        with pytest.raises(TypeCheckError, match="weighted, argument weights"):
            functions.weighted(points(4), np.zeros(4, int))
        with pytest.raises(TypeCheckError, match="weighted, argument weights"):
            functions.weighted(points(4), weights=[0.0] * 4)
        functions.either(points(4), False)
        with pytest.raises(TypeCheckError, match="either, result"):
            functions.either(points(4), True)
        with pytest.raises(TypeCheckError, match="either, argument short"):
            functions.either(points(4), 0)


def test_a_package_that_is_imported_already_cannot_be_checked():
    with pytest.raises(RuntimeError, match=r"imported already: .*depthmocap\.geometry"):
        type_checks.check_types_of("depthmocap", but=())


def test_the_package_is_checked():
    with pytest.raises(TypeCheckError, match="transform_points"):
        transform_points(np.eye(4), np.zeros((5, 2)))
    with pytest.raises(TypeCheckError, match=r"DepthCamera\.__init__, argument world_from_camera"):
        DepthCamera("a", 4, 3, 1.0, 1.0, 1.5, 1.0, np.eye(3))
