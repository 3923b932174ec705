"""The profiles that ship with svmdist, as TOML files beside this one."""
