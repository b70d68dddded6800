"""Number of programs that JAX has compiled for a response, for the tests that count them."""

from typing import Any

from rvjax.response.response import Compiled, Response


def programs(compiled: Compiled, response: Response) -> int:
    """Programs compiled for a plain function; for records, for all of them together."""
    jitted: Any = compiled._program(response)[0]
    return int(jitted._cache_size())
