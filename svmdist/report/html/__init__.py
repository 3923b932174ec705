"""The report: one self-contained HTML file with interactive plots, for a person to find bad frames in."""
