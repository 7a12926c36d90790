"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .columns import (
    BytesColumn as BytesColumn,
    Expected as Expected,
    NestedColumn as NestedColumn,
    RaggedColumn as RaggedColumn,
    RowGroup as RowGroup,
    Rows as Rows,
    class_names as class_names,
    column_names as column_names,
    column_types as column_types,
    dtype_name as dtype_name,
    feature_metadata as feature_metadata,
    label_feature as label_feature,
    list_depth as list_depth,
    null_fields as null_fields,
    ragged_array as ragged_array,
    stored_features as stored_features,
    vectors_type as vectors_type,
    whole_number as whole_number,
    whole_numbers as whole_numbers,
    wrong_type as wrong_type,
)
from .dataset import (
    Record as Record,
    RecordDataset as RecordDataset,
    Row as Row,
    checked_index as checked_index,
    flattened as flattened,
    picks_several as picks_several,
    positions as positions,
)
from .order import (
    StoredParts as StoredParts,
)
from .parquet import (
    ChosenGroups as ChosenGroups,
    Shard as Shard,
    ShardedTable as ShardedTable,
)
from .source import (
    RowSource as RowSource,
    all_blocks as all_blocks,
    row_groups as row_groups,
)
from .stream import (
    Stream as Stream,
    loader_worker as loader_worker,
)
from .torch import (
    TrainingBatches as TrainingBatches,
    shared_zeros as shared_zeros,
)
