"""`functools.cached_property` without the lock that it has before Python 3.12.

That lock is one for all instances. A process that is forked while one of its threads computes such
a value would wait in the child for ever: the thread that is to let go of it is not there. Without
the lock, threads that ask at the same time compute a value twice, and one of the two is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, Self, TypeVar, overload

Value = TypeVar("Value")


class lazy(Generic[Value]):  # noqa: N801 - named as what it replaces
    """A method without arguments, as an attribute that is computed when first asked for."""

    def __init__(self, compute: Callable[[Any], Value]) -> None:
        self._compute = compute
        self.__doc__ = compute.__doc__

    def __set_name__(self, _: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, _: type) -> Self: ...
    @overload
    def __get__(self, instance: object, _: type) -> Value: ...
    def __get__(self, instance: object | None, _: type) -> Self | Value:
        if instance is None:
            return self
        # No __set__: from the next time on Python finds the value in the instance itself.
        value = self._compute(instance)
        vars(instance)[self._name] = value
        return value
