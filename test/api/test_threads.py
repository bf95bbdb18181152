"""Claims about BLAS threads: one where this package computes, the caller's own elsewhere."""

from threadpoolctl import threadpool_info, threadpool_limits

from saddlering_ros.progress import one_blas_thread


def blas_threads():
    return {item['num_threads'] for item in threadpool_info() if item['user_api'] == 'blas'}


def test_blas_has_one_thread_inside_and_what_the_caller_chose_afterwards():
    with threadpool_limits(limits=2, user_api='blas'):
        before = blas_threads()
        assert before == {2}
        with one_blas_thread():
            assert blas_threads() == {1}
        assert blas_threads() == before


def test_a_decorated_function_computes_with_one_thread():
    with threadpool_limits(limits=2, user_api='blas'):
        assert one_blas_thread()(blas_threads)() == {1}
