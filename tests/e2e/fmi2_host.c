/* Steps an FMU for Co-Simulation of FMI 2.0: reads from stdin what it is and its inputs, sample after sample, and
   writes the outputs to stdout, as they lie in memory. On Windows it needs nothing but the system's kernel32, so
   that no C library has to be prepared for it. */
#include <stddef.h>

enum { MOST = 64, CO_SIMULATION = 1, WARNING = 1 };

static struct {
    char library[128], guid[64];
    double h;
    unsigned steps, inputs, outputs, unused;
    unsigned in[MOST], out[MOST]; /* value references */
} request;

#ifdef _WIN32
/* As the system's headers declare them, which come with a C library. */
enum { INPUT = -10, OUTPUT = -11, ZEROED = 8 };
__declspec(dllimport) void *GetStdHandle(unsigned long);
__declspec(dllimport) int ReadFile(void *, void *, unsigned long, unsigned long *, void *);
__declspec(dllimport) int WriteFile(void *, const void *, unsigned long, unsigned long *, void *);
__declspec(dllimport) void *LoadLibraryA(const char *);
__declspec(dllimport) void *GetProcAddress(void *, const char *);
__declspec(dllimport) void *GetProcessHeap(void);
__declspec(dllimport) void *HeapAlloc(void *, unsigned long, size_t);
__declspec(dllimport) int HeapFree(void *, unsigned long, void *);
__declspec(dllimport) void ExitProcess(unsigned);

static int moved(void *memory, size_t size, int writes) {
    char *at = memory;
    while (size) {
        unsigned long count = 0, rest = (unsigned long)size;
        int done = writes ? WriteFile(GetStdHandle((unsigned long)OUTPUT), at, rest, &count, NULL)
                          : ReadFile(GetStdHandle((unsigned long)INPUT), at, rest, &count, NULL);
        if (!done || !count) return 0;
        at += count;
        size -= count;
    }
    return 1;
}
static void *symbol(const char *name) { return GetProcAddress(LoadLibraryA(request.library), name); }
static void *allocate(size_t count, size_t size) { return HeapAlloc(GetProcessHeap(), ZEROED, count * size); }
static void release(void *memory) { HeapFree(GetProcessHeap(), 0, memory); }
#else
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
static int moved(void *memory, size_t size, int writes) {
    return (writes ? fwrite(memory, 1, size, stdout) : fread(memory, 1, size, stdin)) == size;
}
static void *symbol(const char *name) { return dlsym(dlopen(request.library, RTLD_NOW), name); }
static void *allocate(size_t count, size_t size) { return calloc(count, size); }
static void release(void *memory) { free(memory); }
#endif

struct callbacks {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, int);
    void *environment;
};

static void logger(void *environment, const char *name, int status, const char *category, const char *text, ...) {
    (void)environment, (void)name, (void)status, (void)category, (void)text;
}

typedef void *instantiate_t(const char *, int, const char *, const char *, const struct callbacks *, int, int);
typedef int setup_t(void *, int, double, double, int, double);
typedef int call_t(void *);
typedef int set_t(void *, const unsigned *, size_t, const double *);
typedef int get_t(void *, const unsigned *, size_t, double *);
typedef int step_t(void *, double, double, int);
typedef void free_t(void *);

/* Returns 0, or the number of what went wrong. */
static int run(void) {
    static const struct callbacks callbacks = {logger, allocate, release, NULL, NULL};
    static double u[MOST], y[MOST];
    if (!moved(&request, sizeof request, 0)) return 1;
    instantiate_t *instantiate = (instantiate_t *)symbol("fmi2Instantiate");
    if (!instantiate) return 2;
    setup_t *setup = (setup_t *)symbol("fmi2SetupExperiment");
    call_t *enter = (call_t *)symbol("fmi2EnterInitializationMode");
    call_t *leave = (call_t *)symbol("fmi2ExitInitializationMode");
    call_t *terminate = (call_t *)symbol("fmi2Terminate");
    set_t *set = (set_t *)symbol("fmi2SetReal");
    get_t *get = (get_t *)symbol("fmi2GetReal");
    step_t *step = (step_t *)symbol("fmi2DoStep");
    free_t *free_instance = (free_t *)symbol("fmi2FreeInstance");
    void *fmu = instantiate("fmu", CO_SIMULATION, request.guid, "file:///", &callbacks, 0, 0);
    if (!fmu) return 3;
    if (setup(fmu, 0, 0.0, 0.0, 0, 0.0) > WARNING || enter(fmu) > WARNING || leave(fmu) > WARNING) return 4;
    for (unsigned k = 0; k < request.steps; k++) {
        if (!moved(u, request.inputs * sizeof *u, 0)) return 5;
        if (set(fmu, request.in, request.inputs, u) > WARNING) return 6;
        if (step(fmu, k * request.h, request.h, 1) > WARNING) return 7;
        if (get(fmu, request.out, request.outputs, y) > WARNING) return 8;
        if (!moved(y, request.outputs * sizeof *y, 1)) return 9;
    }
    if (terminate(fmu) > WARNING) return 10;
    free_instance(fmu);
    return 0;
}

#ifdef _WIN32
void wWinMainCRTStartup(void) { ExitProcess((unsigned)run()); }
#else
int main(void) { return run(); }
#endif
