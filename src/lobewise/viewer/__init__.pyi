"""What the viewer offers; each module is imported when one of its names is first used."""

from .frame_viewer import FrameViewer as FrameViewer
from .messages import FrameReading as FrameReading
from .server import Viewer as Viewer
