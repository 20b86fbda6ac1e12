"""Every error that the code can raise has a status, a stable code and a docstring."""

import importlib
import pkgutil

import pytest

import app
import filter_core
from app.errors import AppError, DamagedFile
from app.http.problems import STATUS
from filter_core.errors import FilterError

# Errors that may have a status of 500: neither another request nor waiting helps.
MAY_BE_500 = (AppError, DamagedFile)


def import_all_modules() -> None:
    """Import every module of the service and the library, so no subclass is missed."""
    for package in (app, filter_core):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)


def class_and_subclasses(cls: type[Exception]) -> list[type[Exception]]:
    """The class and all classes derived from it."""
    return [
        cls,
        *(
            error
            for child in cls.__subclasses__()
            for error in class_and_subclasses(child)
        ),
    ]


import_all_modules()
ERRORS = [*class_and_subclasses(AppError), *class_and_subclasses(FilterError)]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: error.__name__)
def test_every_error_has_a_status_a_stable_code_and_a_docstring(error):
    statuses = [STATUS[cls] for cls in error.__mro__ if cls in STATUS]

    assert statuses
    assert 400 <= statuses[0] < 600
    assert error in MAY_BE_500 or statuses[0] < 500 or statuses[0] == 503
    assert error.code.replace("_", "").isalpha()
    assert error.code.islower()
    assert error.__doc__


def test_error_codes_are_unique_and_every_class_is_in_its_modules_docstring():
    classes = class_and_subclasses(AppError)
    codes = [vars(cls)["code"] for cls in classes if "code" in vars(cls)]

    assert sorted(codes) == sorted(set(codes))
    for root in (AppError, FilterError):
        module = importlib.import_module(root.__module__)
        own = {
            each.__name__
            for each in class_and_subclasses(root)
            if each.__module__ == root.__module__
        }

        assert {name for name in own if name not in (module.__doc__ or "")} == set()
