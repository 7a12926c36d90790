"""Tables with a row a touch, as `datasets`, pandas and polars read them: the rows are the format."""

from realtouch.exchange.touch_rows import TouchFormat

plan_flat = TouchFormat().plan
