"""The public names; each module is imported when one of its names is first used."""

from .adaptive import find_unsupported as find_unsupported
from .adaptive import recompute as recompute
from .camera import Camera as Camera
from .denoising import denoise as denoise
from .display.progress import ProgressBar as ProgressBar
from .errors import LobewiseError as LobewiseError
from .features.base import Feature as Feature
from .frame import Frame as Frame
from .frame import GBuffer as GBuffer
from .frame import LobeKind as LobeKind
from .frame import Radiance as Radiance
from .frame import Result as Result
from .interchange import read_frame as read_frame
from .interchange import write_result as write_result
from .io.exr import write_frame as write_frame
from .io.exr.sparse import read_sparse_frame as read_sparse_frame
from .io.exr.sparse import write_sparse_frame as write_sparse_frame
from .limits import limit_call as limit_call
from .lobe_table import LobeTable as LobeTable
from .peers import denoise_oidn as denoise_oidn
from .progress import Progress as Progress
from .settings import DenoiseSettings as DenoiseSettings
from .settings import TemporalSettings as TemporalSettings
from .sparse_frame import Rays as Rays
from .sparse_frame import SparseFrame as SparseFrame
from .sparse_frame import make_sparse as make_sparse
from .streaming import DenoisedFile as DenoisedFile
from .streaming import denoise_file as denoise_file
from .temporal import TemporalFilter as TemporalFilter
from .upsampling import upsample as upsample
from .windows import WindowFilter as WindowFilter

__version__: str
