"""The public names of the interactive chain; each module is imported when one of its names is first used."""

from .interactive_frame import InteractiveFrame as InteractiveFrame
from .session import Session as Session
from .settings import InteractiveSettings as InteractiveSettings
