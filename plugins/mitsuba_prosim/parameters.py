"""What plugins say of a wrong parameter."""


def reject(props, name, value, allowed):
    """Returns the error for a parameter outside what is allowed; the caller raises it.

    ``props`` are the plugin's ``mi.Properties``, ``name`` the parameter, ``value`` what was found, ``allowed`` a
    phrase such as ``"a number >= 0"``.
    """
    where = f'"{props.id()}" ({props.plugin_name()})' if props.id() else props.plugin_name()
    return ValueError(f'{where}: parameter "{name}" is {value!r}; allowed: {allowed}.')
