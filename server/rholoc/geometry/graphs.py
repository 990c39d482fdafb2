"""Connected components of index pairs. Apart from the package, because importing scipy's graphs takes time."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rholoc.geometry.arrays import IntArray


def components(count: int, links: IntArray) -> IntArray:
    """Connected component (count,) of each of ``count`` nodes by links (M, 2), numbered by their first nodes."""
    graph = coo_matrix((np.ones(len(links)), links.reshape(-1, 2).T), shape=(count, count))
    label: IntArray = connected_components(graph, directed=False)[1]
    return label
