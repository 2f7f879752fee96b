"""The public names of the interactive chain; each module is imported when one of its names is first used."""

from .session import Session as Session
from .settings import InteractiveSettings as InteractiveSettings
from .views import InteractiveFrame as InteractiveFrame
