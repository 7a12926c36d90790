"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .record import (
    NestedColumn as NestedColumn,
    null_fields as null_fields,
    numpy_values as numpy_values,
    ragged_array as ragged_array,
    RaggedColumn as RaggedColumn,
    Record as Record,
    Row as Row,
    RowGroup as RowGroup,
    vectors_type as vectors_type,
    whole_number as whole_number,
)
from .dataset import (
    LazySequence as LazySequence,
    RecordDataset as RecordDataset,
)
from .schemas import (
    class_names as class_names,
    column_names as column_names,
    column_types as column_types,
    dtype_name as dtype_name,
    value_feature as value_feature,
    Expected as Expected,
    feature_metadata as feature_metadata,
    label_feature as label_feature,
    list_depth as list_depth,
    stored_features as stored_features,
    supported_table as supported_table,
    yaml_features as yaml_features,
)
from .shard import (
    Shard as Shard,
)
from .sharded_table import (
    loader_worker as loader_worker,
    RowSource as RowSource,
    RowStream as RowStream,
    ShardedTable as ShardedTable,
)
from .training_batches import (
    TrainingBatches as TrainingBatches,
    shared_zeros as shared_zeros,
)
