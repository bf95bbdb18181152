"""Where the compiled kernels of the ring are kept."""

from saddlering_ros.caching import CACHE, can_cache

__all__ = ['CACHE', 'can_cache']
