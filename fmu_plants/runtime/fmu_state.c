/* Saving, restoring and serializing the complete state of an instance. */
#include "instance.h"

#include <stdlib.h>
#include <string.h>

/* A saved state is an array of numbers: these, then the state of the simulation. */
enum { SAVED_TYPE, SAVED_MODE, SAVED_EXPERIMENT_DEFINED, SAVED_STOP_TIME, SAVED_SIMULATION };

/* The serialized state is the model's GUID, its terminator, and those numbers in the machine's own format. */
static size_t state_bytes(void)
{
    return (SAVED_SIMULATION + simulation_state_size()) * sizeof(double);
}

static size_t guid_bytes(void)
{
    return strlen(model.guid) + 1;
}

Status instance_get_state(const Instance *instance, void **state, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, state, 1, function)) return STATUS_ERROR;
    double *saved = *state ? *state : malloc(state_bytes());
    if (!saved) return refuse(instance, STATUS_ERROR, "%s: out of memory.", function);
    saved[SAVED_TYPE] = instance->type;
    saved[SAVED_MODE] = instance->mode;
    saved[SAVED_EXPERIMENT_DEFINED] = instance->experiment_defined;
    saved[SAVED_STOP_TIME] = instance->stop_time;
    simulation_save(instance->simulation, saved + SAVED_SIMULATION);
    *state = saved;
    return STATUS_OK;
}

Status instance_set_state(Instance *instance, const void *state, const char *function)
{
    const double *saved = state;
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, saved, 1, function)) return STATUS_ERROR;
    if (saved[SAVED_TYPE] != (double)instance->type) {
        return refuse(instance, STATUS_ERROR, "%s: the state was saved by an instance of the other interface type.",
                      function);
    }
    instance->mode = (Mode)saved[SAVED_MODE];
    instance->experiment_defined = saved[SAVED_EXPERIMENT_DEFINED] != 0.0;
    instance->stop_time = saved[SAVED_STOP_TIME];
    simulation_restore(instance->simulation, saved + SAVED_SIMULATION);
    return STATUS_OK;
}

Status instance_free_state(const Instance *instance, void **state, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return STATUS_OK;
}

Status instance_serialized_size(const Instance *instance, const void *state, size_t *size, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, state, 1, function) || !present(instance, size, 1, function)) return STATUS_ERROR;
    *size = guid_bytes() + state_bytes();
    return STATUS_OK;
}

Status instance_serialize(const Instance *instance, const void *state, void *bytes, size_t size,
                          const char *function)
{
    const size_t needed = guid_bytes() + state_bytes();
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, state, 1, function) || !present(instance, bytes, 1, function)) return STATUS_ERROR;
    if (size < needed) {
        return refuse(instance, STATUS_ERROR, "%s: %zu bytes are needed, %zu were given.", function, needed, size);
    }
    memcpy(bytes, model.guid, guid_bytes());
    memcpy((char *)bytes + guid_bytes(), state, state_bytes());
    return STATUS_OK;
}

Status instance_deserialize(const Instance *instance, const void *bytes, size_t size, void **state,
                            const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    if (!present(instance, bytes, 1, function) || !present(instance, state, 1, function)) return STATUS_ERROR;
    if (size != guid_bytes() + state_bytes() || memcmp(bytes, model.guid, guid_bytes()) != 0) {
        return refuse(instance, STATUS_ERROR, "%s: this is not a state of model %s with GUID %s.", function,
                      model.identifier, model.guid);
    }
    double *saved = *state ? *state : malloc(state_bytes());
    if (!saved) return refuse(instance, STATUS_ERROR, "%s: out of memory.", function);
    memcpy(saved, (const char *)bytes + guid_bytes(), state_bytes());
    *state = saved;
    return STATUS_OK;
}
