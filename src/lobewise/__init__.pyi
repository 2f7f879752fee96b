"""The public names; each module is imported when one of its names is first used."""

from .denoising import denoise as denoise
from .display.progress import ProgressBar as ProgressBar
from .errors import LobewiseError as LobewiseError
from .features.base import Feature as Feature
from .interchange import read_frame as read_frame
from .interchange import write_result as write_result
from .io.exr import write_frame as write_frame
from .io.exr.sparse import read_sparse_frame as read_sparse_frame
from .io.exr.sparse import write_sparse_frame as write_sparse_frame
from .peers import denoise_oidn as denoise_oidn
from .recipes.adaptive import find_unsupported as find_unsupported
from .recipes.adaptive import recompute as recompute
from .recipes.files import FileRequest as FileRequest
from .recipes.files import FileResult as FileResult
from .recipes.files import denoise_files as denoise_files
from .recipes.sequence import SequenceReport as SequenceReport
from .recipes.streaming.recipe import DenoisedFile as DenoisedFile
from .recipes.streaming.recipe import denoise_file as denoise_file
from .recipes.temporal import TemporalFilter as TemporalFilter
from .recipes.upsampling import upsample as upsample
from .recipes.windows import WindowFilter as WindowFilter
from .records.camera import Camera as Camera
from .records.frame import Frame as Frame
from .records.frame import GBuffer as GBuffer
from .records.frame import LobeKind as LobeKind
from .records.frame import Radiance as Radiance
from .records.frame import Result as Result
from .records.lobe_table import LobeTable as LobeTable
from .records.sparse_frame import Rays as Rays
from .records.sparse_frame import SparseFrame as SparseFrame
from .records.sparse_frame import make_sparse as make_sparse
from .settings import DenoiseSettings as DenoiseSettings
from .settings import TemporalSettings as TemporalSettings
from .work.limits import limit_call as limit_call
from .work.progress import Progress as Progress

__version__: str
