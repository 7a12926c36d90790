"""To the Hugging Face Hub and back: reading, downloads, uploads, and the published data sets by name."""
