"""Images and clips: decoding, frames."""
