"""The environments of the package ``tactile-mnist``, made on assets of a provider instead of the Hub's."""
