/* What an instance says, kept for Python: the first messages of a simulation say what went wrong, the rest repeat it.
 */
#ifndef LOG_H
#define LOG_H

#include <stdatomic.h>
#include <stdint.h>

enum { MOST_MESSAGES = 20, LONGEST_TEXT = 2048 };

typedef struct {
  int32_t status;
  char text[LONGEST_TEXT]; /* the end of a longer one is cut off */
} Message;

typedef struct {
  atomic_int count; /* of all messages, also of those that are not kept */
  Message messages[MOST_MESSAGES];
} Log;

/* fmi2CallbackLogger, with a Log as the environment. */
void log_message(void *environment, const char *instance, int32_t status, const char *category, const char *format,
                 ...);

#endif
