/* y' = u for FMI 2.0 Co-Simulation, with no more functions than a run needs.
   The GUID says what happens when t = 0.5 s is passed. */
#include "fmi2Functions.h"

#include <stdlib.h>
#include <string.h>

typedef struct {
    double u, y;
    int aborts, hangs;
} Integrator;

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    Integrator *self = calloc(1, sizeof *self);
    (void)name, (void)type, (void)resources, (void)callbacks, (void)visible, (void)logging;
    if (self) {
        self->aborts = !strcmp(guid, "abort");
        self->hangs = !strcmp(guid, "hang");
    }
    return self;
}

void fmi2FreeInstance(fmi2Component self) { free(self); }
fmi2Status fmi2EnterInitializationMode(fmi2Component self) { return (void)self, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component self) { return (void)self, fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component self) { return (void)self, fmi2OK; }

fmi2Status fmi2SetupExperiment(fmi2Component self, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    (void)self, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component self, const fmi2ValueReference references[], size_t n, const fmi2Real values[]) {
    (void)references;
    if (n)
        ((Integrator *)self)->u = values[0];
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component self, const fmi2ValueReference references[], size_t n, fmi2Real values[]) {
    const Integrator *integrator = self;
    for (size_t i = 0; i < n; i++)
        values[i] = references[i] ? integrator->y : integrator->u;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component self, fmi2Real time, fmi2Real h, fmi2Boolean no_rollback) {
    Integrator *integrator = self;
    (void)no_rollback;
    if (time + h > 0.5 && integrator->aborts)
        abort();
    while (time + h > 0.5 && integrator->hangs)
        ;
    integrator->y += h * integrator->u;
    return fmi2OK;
}
