/* FMI 2.0: saving, restoring and serializing the complete state of an instance (section 2.1.8). */
#include "fmi2_instance.h"

#include <stdlib.h>
#include <string.h>

/* A saved state is an array of numbers: these, then the state of the simulation. */
enum { SAVED_MODE, SAVED_EXPERIMENT_DEFINED, SAVED_STOP_TIME, SAVED_SIMULATION };

/* The serialized state is the model's GUID, its terminator, and those numbers in the machine's own format. */
static size_t state_bytes(void)
{
    return (SAVED_SIMULATION + simulation_state_size()) * sizeof(double);
}

static size_t guid_bytes(void)
{
    return strlen(model.guid) + 1;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    const Instance *instance = c;
    if (!allowed(instance, MODE_ANY, "fmi2GetFMUstate")) return fmi2Error;
    if (!present(instance, FMUstate, 1, "fmi2GetFMUstate")) return fmi2Error;
    double *state = *FMUstate ? *FMUstate : malloc(state_bytes());
    if (!state) return refuse(instance, fmi2Error, "fmi2GetFMUstate: out of memory.");
    state[SAVED_MODE] = instance->mode;
    state[SAVED_EXPERIMENT_DEFINED] = instance->experiment_defined;
    state[SAVED_STOP_TIME] = instance->stop_time;
    simulation_save(instance->simulation, state + SAVED_SIMULATION);
    *FMUstate = state;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    Instance *instance = c;
    const double *state = FMUstate;
    if (!allowed(instance, MODE_ANY, "fmi2SetFMUstate")) return fmi2Error;
    if (!present(instance, state, 1, "fmi2SetFMUstate")) return fmi2Error;
    instance->mode = (Mode)state[SAVED_MODE];
    instance->experiment_defined = state[SAVED_EXPERIMENT_DEFINED] != 0.0;
    instance->stop_time = state[SAVED_STOP_TIME];
    simulation_restore(instance->simulation, state + SAVED_SIMULATION);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    if (!allowed(c, MODE_ANY, "fmi2FreeFMUstate")) return fmi2Error;
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    if (!allowed(c, MODE_ANY, "fmi2SerializedFMUstateSize")) return fmi2Error;
    if (!present(c, FMUstate, 1, "fmi2SerializedFMUstateSize")) return fmi2Error;
    if (!present(c, size, 1, "fmi2SerializedFMUstateSize")) return fmi2Error;
    *size = guid_bytes() + state_bytes();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    const size_t needed = guid_bytes() + state_bytes();
    if (!allowed(c, MODE_ANY, "fmi2SerializeFMUstate")) return fmi2Error;
    if (!present(c, FMUstate, 1, "fmi2SerializeFMUstate")) return fmi2Error;
    if (!present(c, serializedState, 1, "fmi2SerializeFMUstate")) return fmi2Error;
    if (size < needed) {
        return refuse(c, fmi2Error, "fmi2SerializeFMUstate: %zu bytes are needed, %zu were given.", needed, size);
    }
    memcpy(serializedState, model.guid, guid_bytes());
    memcpy(serializedState + guid_bytes(), FMUstate, state_bytes());
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    if (!allowed(c, MODE_ANY, "fmi2DeSerializeFMUstate")) return fmi2Error;
    if (!present(c, serializedState, 1, "fmi2DeSerializeFMUstate")) return fmi2Error;
    if (!present(c, FMUstate, 1, "fmi2DeSerializeFMUstate")) return fmi2Error;
    if (size != guid_bytes() + state_bytes() || memcmp(serializedState, model.guid, guid_bytes()) != 0) {
        return refuse(c, fmi2Error, "fmi2DeSerializeFMUstate: this is not a state of model %s with GUID %s.",
                      model.identifier, model.guid);
    }
    double *state = *FMUstate ? *FMUstate : malloc(state_bytes());
    if (!state) return refuse(c, fmi2Error, "fmi2DeSerializeFMUstate: out of memory.");
    memcpy(state, serializedState + guid_bytes(), state_bytes());
    *FMUstate = state;
    return fmi2OK;
}
