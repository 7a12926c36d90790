"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .columns import (
    BytesColumn as BytesColumn,
    NestedColumn as NestedColumn,
    numpy_values as numpy_values,
    ragged_array as ragged_array,
    RaggedColumn as RaggedColumn,
    vectors_type as vectors_type,
    whole_number as whole_number,
    whole_numbers as whole_numbers,
)
from .dataset import (
    AnyRecords as AnyRecords,
    checked_index as checked_index,
    flattened as flattened,
    picks_several as picks_several,
    positions as positions,
    RecordDataset as RecordDataset,
)
from .schemas import (
    class_names as class_names,
    column_names as column_names,
    column_types as column_types,
    dtype_name as dtype_name,
    Expected as Expected,
    feature_metadata as feature_metadata,
    label_feature as label_feature,
    list_depth as list_depth,
    stored_features as stored_features,
    supported_schema as supported_schema,
    supported_table as supported_table,
    wrong_type as wrong_type,
)
from .order import (
    StoredParts as StoredParts,
)
from .record import (
    null_fields as null_fields,
    Record as Record,
    Row as Row,
    RowGroup as RowGroup,
)
from .shard import (
    Shard as Shard,
)
from .sharded_table import (
    all_blocks as all_blocks,
    loader_worker as loader_worker,
    row_groups as row_groups,
    RowSource as RowSource,
    RowStream as RowStream,
    ShardedTable as ShardedTable,
)
from .training_batches import (
    TrainingBatches as TrainingBatches,
    shared_zeros as shared_zeros,
)
