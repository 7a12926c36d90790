"""Pictures, sheets and pages of touches."""
