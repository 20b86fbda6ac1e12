from unghost.capture.live import (
    Live as Live,
    LiveFrame as LiveFrame,
    LiveOptions as LiveOptions,
    live as live,
)
from unghost.client.client import (
    AsyncClient as AsyncClient,
    Client as Client,
)
from unghost.client.discovery import (
    Server as Server,
    find_server as find_server,
)
from unghost.client.errors import (
    ApiError as ApiError,
    BadRequest as BadRequest,
    Conflict as Conflict,
    DamagedDownload as DamagedDownload,
    Forbidden as Forbidden,
    Invalid as Invalid,
    InvalidName as InvalidName,
    NoResponse as NoResponse,
    NotFound as NotFound,
    RunFailed as RunFailed,
    ServerFault as ServerFault,
    StaleReview as StaleReview,
    TooLarge as TooLarge,
    Unauthorized as Unauthorized,
    Unavailable as Unavailable,
    UnexpectedAnswer as UnexpectedAnswer,
)
from unghost.client.outgoing import (
    AlreadyThere as AlreadyThere,
    NotSent as NotSent,
    Outcome as Outcome,
    OutgoingFrame as OutgoingFrame,
    Sent as Sent,
)
from unghost.client.transport import (
    RetryPolicy as RetryPolicy,
)
from unghost.wire.access import (
    AuditEntry as AuditEntry,
    NewToken as NewToken,
    Session as Session,
    Token as Token,
    Version as Version,
)
from unghost.wire.quality import (
    Agreement as Agreement,
    Band as Band,
    BandScore as BandScore,
    ChannelScore as ChannelScore,
    Confusion as Confusion,
    Evaluation as Evaluation,
    Measure as Measure,
    Pair as Pair,
    Quality as Quality,
    Reviewer as Reviewer,
    Score as Score,
    Suggestion as Suggestion,
    ThresholdPoint as ThresholdPoint,
    WrongBox as WrongBox,
)
from unghost.wire.boxes import (
    Claim as Claim,
    Decision as Decision,
    HiddenBy as HiddenBy,
    HistoryEntry as HistoryEntry,
    Queue as Queue,
    Review as Review,
    ReviewBatch as ReviewBatch,
    ReviewMark as ReviewMark,
    Selection as Selection,
    UndoneBatch as UndoneBatch,
)
from unghost.wire.datasets import (
    Counts as Counts,
    Dataset as Dataset,
    FrameProblem as FrameProblem,
    Histogram as Histogram,
    RefusedFrame as RefusedFrame,
    MapCounts as MapCounts,
    Stats as Stats,
)
from unghost.wire.frames import (
    DistanceBand as DistanceBand,
    PlaceCounts as PlaceCounts,
    Frame as Frame,
    Report as Report,
    SegmentationReport as SegmentationReport,
    StoredFile as StoredFile,
    StoredFrame as StoredFrame,
)
from unghost.wire.model import (
    Fault as Fault,
)
from unghost.wire.runs import (
    ConfigVersion as ConfigVersion,
    Diff as Diff,
    Export as Export,
    Parts as Parts,
    ExportOptions as ExportOptions,
    Failure as Failure,
    Flip as Flip,
    FlipCounts as FlipCounts,
    Preview as Preview,
    Run as Run,
)
