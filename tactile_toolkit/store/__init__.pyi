"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from . import remote as remote
from .addresses import (
    expanded as expanded,
    is_remote as is_remote,
    local_folder_path as local_folder_path,
    normalize_uri as normalize_uri,
    open_folder as open_folder,
    scheme_of as scheme_of,
    split_uri as split_uri,
)
from .building import build as build
from .folder import (
    DataFolder as DataFolder,
    LocalFolder as LocalFolder,
    PENDING_FOLDER as PENDING_FOLDER,
    VERSION_KEYS as VERSION_KEYS,
)
from .download_record import (
    DIGEST as DIGEST,
    DownloadRecord as DownloadRecord,
    HubFile as HubFile,
    digest_like as digest_like,
    has_digest as has_digest,
    read_download_record as read_download_record,
    write_download_record as write_download_record,
)
from .files import (
    DRAFT as DRAFT,
    draft_of as draft_of,
    is_hidden as is_hidden,
    named_failures as named_failures,
    names_inside as names_inside,
    open_regular as open_regular,
    path_exists as path_exists,
    problem_of_name as problem_of_name,
    readable as readable,
    remove_drafts as remove_drafts,
    resource_shortage as resource_shortage,
    scratch_folder as scratch_folder,
    sync_file as sync_file,
    write_file as write_file,
)
from .job import (
    BuildJob as BuildJob,
    MissingPartsError as MissingPartsError,
    inspect_job as inspect_job,
    refuse_unknown_files as refuse_unknown_files,
)
from .locks import (
    LOCK_FILE as LOCK_FILE,
    locked as locked,
)
from .manifest import (
    MANIFEST_FILE as MANIFEST_FILE,
    Manifest as Manifest,
    is_of_others as is_of_others,
    read_manifest as read_manifest,
    without_collecting as without_collecting,
    write_manifest as write_manifest,
)
from .parquet import (
    ParquetStyle as ParquetStyle,
    encode_parquet as encode_parquet,
    named_damage as named_damage,
    open_checked as open_checked,
    require_sound_columns as require_sound_columns,
    open_parquet as open_parquet,
    sha256_hex as sha256_hex,
)
from .pending import (
    manifest_so_far as manifest_so_far,
    pending_shards as pending_shards,
)
from .plan import (
    BuildPlan as BuildPlan,
)
from .remote import (
    CallFailure as CallFailure,
    FsspecFolder as FsspecFolder,
    cause_chain as cause_chain,
    in_time as in_time,
    with_retry as with_retry,
)
from .replacing import (
    require_replaceable as require_replaceable,
    resume_promotion as resume_promotion,
)
from .reports import (
    read_report as read_report,
)
from .run_options import (
    Progress as Progress,
    RunKeywords as RunKeywords,
    RunOptions as RunOptions,
)
from .sealed_json import (
    Count as Count,
    LARGEST as LARGEST,
    convert_json as convert_json,
    damaged_error as damaged_error,
    decode as decode,
)
from .shards import (
    DAMAGED as DAMAGED,
    DATA_FOLDER as DATA_FOLDER,
    Finding as Finding,
    ShardName as ShardName,
    ShardRecord as ShardRecord,
    Skipped as Skipped,
    VIEWER_FOLDER as VIEWER_FOLDER,
    add_up as add_up,
    require_rows as require_rows,
    rows_per_shard as rows_per_shard,
    shard_ranges as shard_ranges,
)
from .task import (
    AnyTask as AnyTask,
    ShardContent as ShardContent,
    ShardTask as ShardTask,
)
from .verification import (
    require_finished as require_finished,
    verify as verify,
)
