"""`rvjax compare`: two results of `rvjax allocate` side by side, or under the requirements of one study."""

from rvjax.commands.compare.compute import Crossed, cost_of, crossed, put_into
from rvjax.commands.compare.results import result

__all__ = ["Crossed", "cost_of", "crossed", "put_into", "result"]
