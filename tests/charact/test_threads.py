"""A method works on one thread of the linear algebra library, whatever the process had, and gives
the others back.
"""

import pytest
import scipy.linalg  # noqa: F401  # its library must be there to be counted
from threadpoolctl import threadpool_info, threadpool_limits

from charact.method import METHODS, register
from charact.method.registry import single_blas_thread
from labdata import Result


def threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


@pytest.fixture
def two_threads():
    with threadpool_limits(limits=2, user_api="blas"):
        yield


def test_a_method_that_fails_gives_the_threads_back(two_threads):
    @single_blas_thread()
    def failing() -> None:
        raise ValueError("on purpose")

    with pytest.raises(ValueError, match="on purpose"):
        failing()
    assert threads() == {2}


def test_a_registered_method_works_so(two_threads):
    register("kind of this test", "counting", quantities=("mtf50",), scope="Counts threads.")(
        lambda: Result(evidence={"threads": {"counts": threads()}})
    )
    method = METHODS.pop(("kind of this test", "counting"))
    assert method.function().evidence["threads"]["counts"] == {1}
    assert threads() == {2}
