"""The old name of the package's error."""

from __future__ import annotations

import pytest

from sensorgraph import errors


def test_the_old_name_is_the_same_class_and_warns() -> None:
    with pytest.warns(DeprecationWarning, match="SensorgraphError"):
        assert errors.GapError is errors.SensorgraphError


def test_other_names_are_not_there() -> None:
    with pytest.raises(AttributeError, match="NoSuchError"):
        _ = errors.NoSuchError
