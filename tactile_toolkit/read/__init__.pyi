"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .record import (
    FieldAccess as FieldAccess,
    NestedColumn as NestedColumn,
    null_fields as null_fields,
    numpy_values as numpy_values,
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
    absent_columns as absent_columns,
    class_names as class_names,
    column_names as column_names,
    column_types as column_types,
    dtype_name as dtype_name,
    Expected as Expected,
    list_depth as list_depth,
    supported_table as supported_table,
    with_absent as with_absent,
)
from .shard import (
    Shard as Shard,
)
from .sharded_table import (
    RowSource as RowSource,
    RowStream as RowStream,
    ShardedTable as ShardedTable,
)
from .training_batches import (
    TrainingBatches as TrainingBatches,
)
