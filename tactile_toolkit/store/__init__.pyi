"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .addresses import (
    list_files as list_files,
    local_path as local_path,
    open_folder as open_folder,
    open_output as open_output,
    Output as Output,
    scheme_of as scheme_of,
    split_uri as split_uri,
)
from .building import (
    build as build,
)
from .folder import (
    DataFolder as DataFolder,
)
from .verification import (
    read_download_record as read_download_record,
    Verification as Verification,
    verify as verify,
)
from .files import (
    expanded as expanded,
    is_hidden as is_hidden,
    names_inside as names_inside,
    open_regular as open_regular,
    path_exists as path_exists,
    problem_of_name as problem_of_name,
)
from .job import (
    BuildPlan as BuildPlan,
    MissingPartsError as MissingPartsError,
    Progress as Progress,
    RunKeywords as RunKeywords,
    RunOptions as RunOptions,
    ShardContent as ShardContent,
    ShardTask as ShardTask,
)
from .locks import (
    locked as locked,
)
from .manifest import (
    CARD_FILE as CARD_FILE,
    damaged_error as damaged_error,
    decode as decode,
    Finding as Finding,
    Manifest as Manifest,
    MANIFEST_FILE as MANIFEST_FILE,
    read_manifest as read_manifest,
    rows_per_shard as rows_per_shard,
    ShardName as ShardName,
    Skipped as Skipped,
    without_collecting as without_collecting,
)
from .parquet import (
    named_damage as named_damage,
    open_checked as open_checked,
    ParquetStyle as ParquetStyle,
)
