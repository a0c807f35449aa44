"""The thesis's scene language, translated to Mitsuba XML and PLY meshes. Never imports Mitsuba."""
