"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .arrow_views import (
    BytesColumn as BytesColumn,
    NestedColumn as NestedColumn,
    RaggedColumn as RaggedColumn,
    numpy_values as numpy_values,
    ragged_array as ragged_array,
    vectors_type as vectors_type,
)
from .dataset import (
    AnyRecords as AnyRecords,
    RecordDataset as RecordDataset,
)
from .features import (
    class_names as class_names,
    dtype_name as dtype_name,
    feature_metadata as feature_metadata,
    label_feature as label_feature,
    stored_features as stored_features,
)
from .indexing import (
    checked_index as checked_index,
    flattened as flattened,
    picks_several as picks_several,
    positions as positions,
)
from .order import (
    StoredParts as StoredParts,
)
from .record import (
    Record as Record,
    Row as Row,
)
from .row_group import (
    RowGroup as RowGroup,
    Rows as Rows,
    null_fields as null_fields,
)
from .schemas import (
    Expected as Expected,
    column_names as column_names,
    column_types as column_types,
    list_depth as list_depth,
    wrong_type as wrong_type,
)
from .shard import (
    Shard as Shard,
)
from .sharded_table import (
    ShardedTable as ShardedTable,
)
from .source import (
    RowSource as RowSource,
    all_blocks as all_blocks,
    row_groups as row_groups,
)
from .stream import (
    RowStream as RowStream,
    loader_worker as loader_worker,
)
from .supported_types import (
    supported_schema as supported_schema,
    supported_table as supported_table,
)
from .training_batches import (
    TrainingBatches as TrainingBatches,
    shared_zeros as shared_zeros,
)
from .integer_columns import (
    whole_number as whole_number,
    whole_numbers as whole_numbers,
)
