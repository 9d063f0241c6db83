// What stands between Micro-Manager's device adapter for the TriggerScope and a test: the part of its core that such an
// adapter calls. Serial traffic goes out as lines on standard output, whose answers come in as lines:
//
//   > HEX     sent to the controller                   ? asks for an answer: HEX, or - where none came in time
//   purge     forgets what the controller has said
//   = CODE    what a device said to the last command; value TEXT before it, where one was asked for
//
// Commands, a line each: init DEVICE | set DEVICE|PROPERTY|VALUE | load DEVICE|PROPERTY|VALUE... |
// start DEVICE|PROPERTY | stop DEVICE|PROPERTY | get DEVICE|PROPERTY | gate DEVICE|0 or 1

#include "MMDevice.h"
#include "MMDeviceConstants.h"
#include "ModuleInterface.h"

#include <iostream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

namespace {

struct TestCore : MM::Core {
    MM::Hub *hub = nullptr;

    int SetSerialCommand(const MM::Device *, const char *, const char *command, const char *term) override {
        static const char digits[] = "0123456789abcdef";
        std::cout << "> ";
        for (unsigned char each : std::string(command) + term)
            std::cout << digits[each >> 4] << digits[each & 15];
        std::cout << std::endl;
        return DEVICE_OK;
    }
    int GetSerialAnswer(const MM::Device *, const char *, unsigned long most, char *answer, const char *) override {
        std::string line;
        std::cout << "?" << std::endl;
        std::getline(std::cin, line);
        if (line == "-")
            return DEVICE_SERIAL_TIMEOUT;
        std::string text;
        for (size_t at = 0; at + 1 < line.size(); at += 2)
            text += static_cast<char>(std::stoi(line.substr(at, 2), nullptr, 16));
        if (text.size() + 1 > most)
            return DEVICE_SERIAL_BUFFER_OVERRUN;
        text.copy(answer, text.size());
        answer[text.size()] = 0;
        return DEVICE_OK;
    }
    int ReadFromSerial(const MM::Device *, const char *, unsigned char *, unsigned long, unsigned long &read) override {
        read = 0;
        return DEVICE_OK;
    }
    int PurgeSerial(const MM::Device *, const char *) override {
        std::cout << "purge" << std::endl;
        return DEVICE_OK;
    }
    MM::Hub *GetParentHub(const MM::Device *) const override { return hub; }
    MM::PortType GetSerialPortType(const char *) const override { return MM::SerialPort; }
    int LogMessage(const MM::Device *, const char *, bool) const override { return DEVICE_OK; }
    MM::Device *GetDevice(const MM::Device *, const char *) override { return nullptr; }
    int GetDeviceProperty(const char *, const char *, char *) override { return DEVICE_OK; }
    int SetDeviceProperty(const char *, const char *, const char *) override { return DEVICE_OK; }
    void GetLoadedDeviceOfType(const MM::Device *, MM::DeviceType, char *, const unsigned int) override {}
    int SetSerialProperties(const char *, const char *, const char *, const char *, const char *, const char *,
                            const char *) override { return DEVICE_OK; }
    int WriteToSerial(const MM::Device *, const char *, const unsigned char *, unsigned long) override { return 1; }
    int OnPropertiesChanged(const MM::Device *) override { return DEVICE_OK; }
    int OnPropertyChanged(const MM::Device *, const char *, const char *) override { return DEVICE_OK; }
    int OnStagePositionChanged(const MM::Device *, double) override { return DEVICE_OK; }
    int OnXYStagePositionChanged(const MM::Device *, double, double) override { return DEVICE_OK; }
    int OnExposureChanged(const MM::Device *, double) override { return DEVICE_OK; }
    int OnSLMExposureChanged(const MM::Device *, double) override { return DEVICE_OK; }
    int OnMagnifierChanged(const MM::Device *) override { return DEVICE_OK; }
    int OnShutterOpenChanged(const MM::Device *, bool) override { return DEVICE_OK; }
    unsigned long GetClockTicksUs(const MM::Device *) override { return 0; }
    MM::MMTime GetCurrentMMTime() override { return MM::MMTime(); }
    int AcqFinished(const MM::Device *, int) override { return DEVICE_OK; }
    int PrepareForAcq(const MM::Device *) override { return DEVICE_OK; }
    int InsertImage(const MM::Device *, const unsigned char *, unsigned, unsigned, unsigned, unsigned,
                    const char *) override { return DEVICE_OK; }
    int InsertImage(const MM::Device *, const unsigned char *, unsigned, unsigned, unsigned,
                    const char *) override { return DEVICE_OK; }
    bool InitializeImageBuffer(unsigned, unsigned, unsigned int, unsigned int, unsigned int) override { return true; }
    int GetFocusPosition(double &) override { return DEVICE_OK; }
    MM::SignalIO *GetSignalIODevice(const MM::Device *, const char *) override { return nullptr; }
};

std::vector<std::string> split(const std::string &text) {
    std::vector<std::string> words;
    std::stringstream stream(text);
    for (std::string word; std::getline(stream, word, '|');)
        words.push_back(word);
    return words;
}

}  // namespace

int main() {
    TestCore core;
    std::map<std::string, MM::Device *> devices;
    InitializeModuleData();
    for (std::string line; std::getline(std::cin, line);) {
        const size_t space = line.find(' ');
        const std::string verb = line.substr(0, space);
        const std::vector<std::string> words = split(line.substr(space + 1));
        MM::Device *&device = devices[words[0]];
        int code = DEVICE_OK;
        if (!device) {
            device = CreateDevice(words[0].c_str());
            device->SetLabel(words[0].c_str());
            device->SetCallback(&core);
            if (device->GetType() == MM::HubDevice) {
                core.hub = static_cast<MM::Hub *>(device);
                device->SetProperty(MM::g_Keyword_Port, "PORT");
            }
        }
        if (verb == "init") {
            code = device->Initialize();
        } else if (verb == "set") {
            code = device->SetProperty(words[1].c_str(), words[2].c_str());
        } else if (verb == "get") {
            char value[MM::MaxStrLength] = "";
            code = device->GetProperty(words[1].c_str(), value);
            std::cout << "value " << value << std::endl;
        } else if (verb == "load") {
            code = device->ClearPropertySequence(words[1].c_str());
            for (size_t at = 2; at < words.size() && code == DEVICE_OK; ++at)
                code = device->AddToPropertySequence(words[1].c_str(), words[at].c_str());
            if (code == DEVICE_OK)
                code = device->SendPropertySequence(words[1].c_str());
        } else if (verb == "start") {
            code = device->StartPropertySequence(words[1].c_str());
        } else if (verb == "stop") {
            code = device->StopPropertySequence(words[1].c_str());
        } else if (verb == "gate") {
            const bool open = words[1] == "1";
            MM::SignalIO *signal = dynamic_cast<MM::SignalIO *>(device);
            code = signal ? signal->SetGateOpen(open) : dynamic_cast<MM::State *>(device)->SetGateOpen(open);
        } else {
            code = -1;
        }
        std::cout << "= " << code << std::endl;
    }
}
