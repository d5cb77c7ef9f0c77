"""Paths of ROS bags with a topic behind them, as `monday.bag#/velodyne_points`."""

from pathlib import Path


def without_topic(path: Path) -> Path:
    """Return a path without the topic behind its last `#`, whether or not there is such a bag.

    Folders may have a `#` in their names, topics have none. What exists has no topic behind it.

    Examples:
        >>> without_topic(Path("run#3/monday.bag#/velodyne_points")).as_posix()
        'run#3/monday.bag'
        >>> without_topic(Path("run#3/monday.bag")).as_posix()
        'run#3/monday.bag'
    """
    bag, mark, _ = str(path).rpartition("#/")
    return Path(bag) if mark and not path.exists() else path
