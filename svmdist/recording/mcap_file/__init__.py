"""MCAP files to raw messages: framing, CRCs, chunks, definitions, the summary, and what was lost."""
