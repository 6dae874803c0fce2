"""Errors for operators: one line, and whether another attempt may help."""

from __future__ import annotations

import pytest

from hal.contract import BackendError
from hal.errors import OperatorError, one_line
from hal.scenes import SceneError
from hal.unitree.factory import MissingExtra
from hal.unitree.link import check_interface


def test_the_class_says_whether_another_attempt_may_help_and_the_instance_knows_better() -> None:
    assert BackendError("cable").retry
    assert not BackendError("name", retry=False).retry
    assert BackendError("cable").retry  # the class is as it was
    assert not SceneError("no such file").retry
    assert not MissingExtra("cyclonedds").retry


def test_an_interface_that_does_not_exist_is_not_waited_for() -> None:
    with pytest.raises(BackendError, match="does not exist") as raised:
        check_interface("none0")
    assert not raised.value.retry


def test_an_operator_reads_one_line() -> None:
    assert one_line(OperatorError("pull the plug\nthen wait")) == "pull the plug"
    assert one_line(KeyError()) == "KeyError"
