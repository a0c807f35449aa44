/* A stand-in for a Mitsuba plugin that is written in Python.
 *
 * The native `mitsuba` command has no Python. When a scene names a plugin, it opens mitsuba/plugins/NAME.so and calls
 * `init_plugin` there. This file, installed under the name of a Python plugin, then replaces the process by a Python
 * interpreter that renders the same scenes with the same options (hosted.py). It uses no Mitsuba, C++ or Python ABI,
 * only the name of that function, whose arguments it ignores. In any other program than `mitsuba` it does nothing, and
 * Mitsuba says that the plugin could not be found.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <signal.h>
#include <string.h>
#include <sys/prctl.h>
#include <unistd.h>

/* By these words stand_ins.py knows a stand-in from a true plugin. */
__attribute__((used)) static const char mark[] = "mitsuba-prosim stand-in for a Python plugin, 3";

/* Not `python -m`, which would look for modules among the scenes, in the current folder. */
static char program[] =
    "import sys\n"
    "sys.path = [p for p in sys.path if p]\n"
    "try:\n"
    "    from mitsuba_prosim.stock_command.hosted import main\n"
    "except ModuleNotFoundError as error:\n"
    "    sys.exit(f'mitsuba: {sys.executable}: {error}. Set MITSUBA_PYTHON to the interpreter that has the plugins.')\n"
    "sys.exit(main(*sys.argv[1:]))\n";

static char executable[PATH_MAX], prefix[PATH_MAX], candidates[3][PATH_MAX + 32], arguments[1 << 21], parents[1 << 21];

static char *words[sizeof arguments / 2 + 5];

/* The interpreter of the Python that Mitsuba is installed for: PREFIX/lib/python3.X/site-packages/mitsuba/mitsuba. */
static const char *find_python(void) {
    char version[16] = "3", *library;
    strcpy(prefix, executable);
    if ((library = strstr(prefix, "/lib/python")) || (library = strstr(prefix, "/lib64/python"))) {
        sscanf(strstr(library, "/python") + 7, "%15[0-9.]", version);
        *library = 0;
    }
    const char *python = getenv("MITSUBA_PYTHON");
    if (python)
        return python;
#ifdef PYTHON /* the one that ran prosim link */
    if (access(PYTHON, X_OK) == 0)
        return PYTHON;
#endif
    snprintf(candidates[0], sizeof candidates[0], "%s/bin/python%s", prefix, version); /* environments, /usr/local */
    snprintf(candidates[1], sizeof candidates[1], "/usr/bin/python%s", version);       /* dist-packages, ~/.local */
    snprintf(candidates[2], sizeof candidates[2], "python%s", version);                /* wherever PATH leads */
    for (int i = 0; i < 2; ++i)
        if (access(candidates[i], X_OK) == 0)
            return candidates[i];
    return candidates[2];
}

/* What is in /proc/PROCESS/cmdline, at most so much; returns how much. */
static size_t read_arguments(const char *process, char *text, size_t most) {
    char path[64];
    snprintf(path, sizeof path, "/proc/%s/cmdline", process);
    FILE *file = fopen(path, "rb");
    size_t size = file ? fread(text, 1, most, file) : 0;
    if (file)
        fclose(file);
    return size;
}

/* Mitsuba's command is a launcher, which starts this program with the same arguments and waits for it. A signal that
 * ends the launcher alone has to end this process too, or it would go on rendering unseen. Any other parent, a shell
 * say, may end without that. */
static void end_with_launcher(size_t size) {
    char parent[16];
    pid_t launcher = getppid();
    snprintf(parent, sizeof parent, "%d", (int) launcher);
    size_t own = strlen(arguments) + 1, theirs = read_arguments(parent, parents, sizeof parents - 1);
    if (size < own || theirs < size - own || memcmp(parents + theirs - (size - own), arguments + own, size - own))
        return;
    /* The word before the arguments is the launcher's file. */
    size_t end = theirs - (size - own);
    const char *name = NULL;
    for (char *word = parents; word < parents + end; word += strlen(word) + 1)
        name = word;
    const char *slash = name ? strrchr(name, '/') : NULL;
    if (!name || strcmp(slash ? slash + 1 : name, "mitsuba"))
        return;
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != launcher) /* ended just now */
        raise(SIGTERM);
}

__attribute__((visibility("default"))) void init_plugin(void) {
    ssize_t length = readlink("/proc/self/exe", executable, sizeof executable - 1);
    const char *slash = length > 0 ? strrchr(executable, '/') : NULL;
    if (!slash || strcmp(slash, "/mitsuba"))
        return;

    /* The name of the plugin is that of this file. */
    static char name[PATH_MAX];
    Dl_info self;
    if (!dladdr((void *) (size_t) init_plugin, &self) || !(slash = strrchr(self.dli_fname, '/')))
        return;
    sscanf(slash, "/%4000[^.]", name);

    size_t size = read_arguments("self", arguments, sizeof arguments - 1), count = 0;
    if (!size)
        return;
    end_with_launcher(size);

    const char *python = find_python();
    words[count++] = (char *) python;
    words[count++] = "-c";
    words[count++] = program;
    words[count++] = name;
    for (char *word = arguments + strlen(arguments) + 1; word < arguments + size; word += strlen(word) + 1)
        words[count++] = word;
    words[count] = NULL;
    fflush(NULL);
    execvp(python, words);
    fprintf(stderr, "mitsuba: this scene names a plugin that is written in Python, but \"%s\" could not be started: %s. "
                    "Set MITSUBA_PYTHON to the interpreter that has the plugin.\n", python, strerror(errno));
}
