"""The judge of ``slefejax attack``: it shares no code with the prediction, nor with what the package measures by."""
