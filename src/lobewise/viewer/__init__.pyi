"""What the viewer offers; each module is imported when one of its names is first used."""

from .looks import FrameLook as FrameLook
from .messages import FrameReading as FrameReading
from .server import Viewer as Viewer
