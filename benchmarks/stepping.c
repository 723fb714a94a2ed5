/* Times steps of a controller in C: of its code, and of its FMU as an importer in C calls it. */
#define _POSIX_C_SOURCE 199309L
#include "controller.h"

#include <string.h>
#include <time.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

/* Step through samples one after another; the time of each is the least of so many repetitions [us]. */
void time_code(const double *y, const double *r, size_t samples, int repetitions, double *u, double *times,
               unsigned *status, unsigned *iterations, unsigned *active)
{
    static ControllerState state, before;
    controller_start(&state);
    for (size_t k = 0; k < samples; ++k) {
        before = state;
        for (int i = 0; i < repetitions; ++i) {
            state = before;
            const double start = now();
            controller_step(&state, y + k * CONTROLLER_MEASUREMENTS, r + k * CONTROLLER_REFERENCES,
                            u + k * CONTROLLER_INPUTS);
            const double passed = now() - start;
            if (i == 0 || passed < times[k]) times[k] = passed;
        }
        status[k] = state.status;
        iterations[k] = state.iterations;
        active[k] = state.active_bounds;
    }
}

typedef int (*Set)(void *, const unsigned *, size_t, const double *);
typedef int (*Get)(void *, const unsigned *, size_t, double *);
typedef int (*DoStep)(void *, double, double, int);

/* The same through FMI 2.0: set the inputs, step, get the outputs; a step is not repeated. 1 if a call failed. */
int time_fmu(void *fmu, Set set, DoStep step, Get get, const unsigned *inputs, size_t n, const unsigned *outputs,
             size_t m, double h, const double *values, size_t samples, double *u, double *times)
{
    for (size_t k = 0; k < samples; ++k) {
        const double start = now();
        if (set(fmu, inputs, n, values + k * n) || step(fmu, (double)k * h, h, 1) || get(fmu, outputs, m, u + k * m))
            return 1;
        times[k] = now() - start;
    }
    return 0;
}
