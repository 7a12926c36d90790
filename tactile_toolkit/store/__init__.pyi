"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from . import remote as remote
from .addresses import (
    local_folder_path as local_folder_path,
    local_path as local_path,
    open_folder as open_folder,
    scheme_of as scheme_of,
    split_uri as split_uri,
)
from .building import (
    build as build,
    require_replaceable as require_replaceable,
    resume_promotion as resume_promotion,
)
from .folder import (
    DataFolder as DataFolder,
    LocalFolder as LocalFolder,
    PENDING_FOLDER as PENDING_FOLDER,
    VERSION_KEYS as VERSION_KEYS,
)
from .verification import (
    DIGEST as DIGEST,
    digest_like as digest_like,
    DownloadRecord as DownloadRecord,
    has_digest as has_digest,
    HubFile as HubFile,
    read_download_record as read_download_record,
    require_finished as require_finished,
    verify as verify,
    write_download_record as write_download_record,
)
from .files import (
    DRAFT as DRAFT,
    draft_of as draft_of,
    expanded as expanded,
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
    BuildPlan as BuildPlan,
    manifest_so_far as manifest_so_far,
    MissingPartsError as MissingPartsError,
    pending_shards as pending_shards,
    Progress as Progress,
    refuse_unknown_files as refuse_unknown_files,
    RunKeywords as RunKeywords,
    RunOptions as RunOptions,
    ShardContent as ShardContent,
    ShardTask as ShardTask,
)
from .locks import (
    LOCK_FILE as LOCK_FILE,
    locked as locked,
)
from .manifest import (
    add_up as add_up,
    CARD_FILE as CARD_FILE,
    Count as Count,
    damaged_error as damaged_error,
    DATA_FOLDER as DATA_FOLDER,
    decode as decode,
    Finding as Finding,
    is_of_others as is_of_others,
    Manifest as Manifest,
    MANIFEST_FILE as MANIFEST_FILE,
    read_manifest as read_manifest,
    require_rows as require_rows,
    rows_per_shard as rows_per_shard,
    shard_ranges as shard_ranges,
    ShardName as ShardName,
    ShardRecord as ShardRecord,
    Skipped as Skipped,
    VIEWER_FOLDER as VIEWER_FOLDER,
    without_collecting as without_collecting,
    write_manifest as write_manifest,
)
from .parquet import (
    encode_parquet as encode_parquet,
    named_damage as named_damage,
    open_checked as open_checked,
    ParquetStyle as ParquetStyle,
    read_report as read_report,
    require_sound_columns as require_sound_columns,
    sha256_hex as sha256_hex,
)
from .remote import (
    CallFailure as CallFailure,
    FsspecFolder as FsspecFolder,
    cause_chain as cause_chain,
    in_time as in_time,
    with_retry as with_retry,
)
