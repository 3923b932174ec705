"""What images and tissue of a real room show and the ideal world does not: lens, motion, light, dirt, video."""
