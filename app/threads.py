"""How many threads the linear algebra may use."""

from threadpoolctl import threadpool_limits

__all__ = ["one_blas_thread"]


def one_blas_thread() -> None:
    """Keep NumPy's and SciPy's BLAS to one thread for the rest of this process.

    The matrices here are small: more threads slow a query down (0.1 s instead of 6 ms to project
    a segment on two cores, measured) and make a sum depend on how many there are, so that the
    same drive would get another digest on another machine.
    """
    threadpool_limits(limits=1)
